"""A ROS 2 bag (SQLite, format version 8) as a car records it, from the frames of any source."""

from __future__ import annotations

import errno
import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rosbags.rosbag2
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from vehicle_client.frames import Matrix, yaw_from_heading
from vehicle_client.recording import ros_covariances
from vehicle_client.sources.frame import GnssFix, LidarFrame

POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("time", "<f4"), ("ring", "<u2"), ("none", "<u2")])
DATATYPES = {"<f4": 7, "<u2": 4}
STORE = get_typestore(Stores.ROS2_HUMBLE)
UNSTATED = QosTime(0, 0)
LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    UNSTATED,
    UNSTATED,
    QosLiveliness.AUTOMATIC,
    UNSTATED,
    avoid_ros_namespace_conventions=False,
)
"""Kept for whoever subscribes later, as tf2 offers and asks for `/tf_static`, which is said once."""

QOS = {"/tf_static": (LATCHED,)}


def write_bag(folder: Path, frames: Iterable[LidarFrame], vehicle_from_sensor: Matrix) -> Path:
    """Write `/lidar/points`, `/gnss/fix`, `/imu/data` with the fix's heading, `/odom`, `/tf`, `/tf_static` to a folder.

    Points have x, y, z, ring and time (seconds after the stamp, the sweep's end: zero or negative). The vehicle's frame
    is `base_link` (REP 105); fixes and headings are of its origin. Pictures, steering and earlier fixes of a frame stay
    behind. `FileExistsError` if the folder is there.
    """
    if folder.exists():
        raise FileExistsError(errno.EEXIST, "is there already; give a new name", str(folder))
    with rosbags.rosbag2.Writer(folder, version=8) as writer:
        connections: dict[str, Any] = {}
        for stamp_s, topic, message in _said(frames, vehicle_from_sensor):
            kind = message.__msgtype__
            if topic not in connections:
                qos = QOS.get(topic, ())
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE, offered_qos_profiles=qos)
            writer.write(connections[topic], round(stamp_s * 1e9), STORE.serialize_cdr(message, kind))
    return folder


def _with_ways(frames: Iterable[LidarFrame]) -> Iterator[tuple[LidarFrame, float]]:
    """Each frame with the way since the first one, by its odometry."""
    way_m, last = 0.0, None
    for frame in frames:
        here = frame.odom_from_vehicle
        if here is not None and last is not None:
            way_m += float(np.linalg.norm(here[:3, 3] - last[:3, 3]))
        last = last if here is None else here
        yield frame, way_m


def _said(frames: Iterable[LidarFrame], vehicle_from_sensor: Matrix) -> Iterator[tuple[float, str, Any]]:
    """Stamp, topic and message."""
    for index, (frame, way_m) in enumerate(_with_ways(frames)):
        if index == 0:
            yield frame.stamp_s, "/tf_static", _mounting(frame.stamp_s, vehicle_from_sensor)
        for topic, message in _said_of(frame, way_m):
            yield frame.stamp_s, topic, message


def _said_of(frame: LidarFrame, way_m: float) -> Iterator[tuple[str, Any]]:
    if frame.gnss is not None:
        yield "/gnss/fix", _fix(frame.stamp_s, frame.gnss)
        if frame.gnss.heading_rad is not None:
            yield "/imu/data", _imu(frame.stamp_s, yaw_from_heading(frame.gnss.heading_rad))
    if frame.odom_from_vehicle is not None:
        yield "/odom", _odometry(frame, frame.odom_from_vehicle, way_m)
        placed = _transform(frame.stamp_s, "odom", "base_link", frame.odom_from_vehicle)
        yield "/tf", _of("tf2_msgs/msg/TFMessage", transforms=[placed])
    yield "/lidar/points", _cloud(frame)


def _of(kind: str, /, **values: Any) -> Any:
    return STORE.types[kind](**values)


def _header(stamp_s: float, frame: str) -> Any:
    seconds, nanoseconds = divmod(round(stamp_s * 1e9), 10**9)
    stamp = _of("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    return _of("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def _mounting(stamp_s: float, vehicle_from_sensor: Matrix) -> Any:
    places = {"lidar": vehicle_from_sensor, "gnss": np.eye(4), "imu": np.eye(4)}
    transforms = [_transform(stamp_s, "base_link", name, place) for name, place in places.items()]
    return _of("tf2_msgs/msg/TFMessage", transforms=transforms)


def _transform(stamp_s: float, a: str, b: str, a_from_b: Matrix) -> Any:
    """It takes points of b into a: a is the parent, and b the child."""
    placed = _of(
        "geometry_msgs/msg/Transform",
        translation=_vector(*map(float, a_from_b[:3, 3])),
        rotation=_quaternion(a_from_b[:3, :3]),
    )
    return _of("geometry_msgs/msg/TransformStamped", header=_header(stamp_s, a), child_frame_id=b, transform=placed)


def _cloud(frame: LidarFrame) -> Any:
    number = len(frame.points_m)
    made = np.zeros(number, dtype=POINT)
    made["x"], made["y"], made["z"] = frame.points_m.T
    made["ring"] = 0 if frame.ring is None else frame.ring
    made["time"] = 0.0 if frame.point_time_s is None else frame.point_time_s
    fields = [
        _of("sensor_msgs/msg/PointField", name=name, offset=offset, datatype=DATATYPES[kind.str], count=1)
        for name, (kind, offset) in ((name, POINT.fields[name][:2]) for name in ("x", "y", "z", "time", "ring"))  # type: ignore[index]  # NumPy: may be None
    ]
    return _of(
        "sensor_msgs/msg/PointCloud2",
        header=_header(frame.stamp_s, "lidar"),
        height=1,
        width=number,
        fields=fields,
        is_bigendian=False,
        point_step=POINT.itemsize,
        row_step=number * POINT.itemsize,
        data=made.view(np.uint8),
        is_dense=True,
    )


def _fix(stamp_s: float, fix: GnssFix) -> Any:
    return _of(
        "sensor_msgs/msg/NavSatFix",
        header=_header(stamp_s, "gnss"),
        status=_of("sensor_msgs/msg/NavSatStatus", status=0, service=1),
        latitude=fix.position.latitude_deg,
        longitude=fix.position.longitude_deg,
        altitude=fix.altitude_m,
        position_covariance=np.diag([fix.sd_m**2, fix.sd_m**2, fix.altitude_sd_m**2]).ravel(),
        position_covariance_type=2,
    )


def _imu(stamp_s: float, yaw_rad: float) -> Any:
    turned = _of("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(yaw_rad / 2), w=math.cos(yaw_rad / 2))
    return _of(
        "sensor_msgs/msg/Imu",
        header=_header(stamp_s, "imu"),
        orientation=turned,
        orientation_covariance=ros_covariances.of_heading(),
        angular_velocity=_vector(0.0, 0.0, 0.0),
        angular_velocity_covariance=ros_covariances.unsaid(),
        linear_acceleration=_vector(0.0, 0.0, 0.0),
        linear_acceleration_covariance=ros_covariances.unsaid(),
    )


def _odometry(frame: LidarFrame, odom_from_vehicle: Matrix, way_m: float) -> Any:
    x, y, z = map(float, odom_from_vehicle[:3, 3])
    pose = _of(
        "geometry_msgs/msg/Pose",
        position=_of("geometry_msgs/msg/Point", x=x, y=y, z=z),
        orientation=_quaternion(odom_from_vehicle[:3, :3]),
    )
    speed = _vector(frame.speed_mps or 0.0, 0.0, 0.0)
    twist = _of("geometry_msgs/msg/Twist", linear=speed, angular=_vector(0.0, 0.0, 0.0))
    pose_covariance = ros_covariances.of_odometry(odom_from_vehicle, way_m)
    twist_covariance = ros_covariances.of_speed(frame.speed_mps)
    return _of(
        "nav_msgs/msg/Odometry",
        header=_header(frame.stamp_s, "odom"),
        child_frame_id="base_link",
        pose=_of("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=pose_covariance),
        twist=_of("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=twist_covariance),
    )


def _quaternion(rotation: Matrix) -> Any:
    x, y, z, w = map(float, Rotation.from_matrix(rotation).as_quat())
    return _of("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _vector(x: float, y: float, z: float) -> Any:
    return _of("geometry_msgs/msg/Vector3", x=x, y=y, z=z)
