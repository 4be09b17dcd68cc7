"""A ROS 2 bag (SQLite, format version 8) as a car records it, from the frames of any source."""

from __future__ import annotations

import errno
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import rosbags.rosbag2
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from vehicle_client.frames import Matrix, yaw_from_heading
from vehicle_client.sources.frame import GnssFix, LidarFrame

POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("time", "<f4"), ("ring", "<u2"), ("none", "<u2")])
DATATYPES = {"<f4": 7, "<u2": 4}
HEADING_SD_RAD = math.radians(0.3)
"""What is stated of a heading: antennas 2 m apart, or a good inertial unit."""

STORE = get_typestore(Stores.ROS2_HUMBLE)


def write_bag(folder: Path, frames: Iterable[LidarFrame]) -> Path:
    """Write `/lidar/points`, `/gnss/fix`, `/imu/data` with the fix's heading, and `/odom` to a new folder.

    Points have x, y, z, ring and time (seconds from the frame's stamp). Pictures, steering and earlier fixes of a frame
    stay behind. `FileExistsError` if the folder is there.
    """
    if folder.exists():
        raise FileExistsError(errno.EEXIST, "is there already; give a new name", str(folder))
    with rosbags.rosbag2.Writer(folder, version=8) as writer:
        connections: dict[str, Any] = {}
        for frame in frames:
            for topic, message in _said(frame):
                kind = message.__msgtype__
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
                writer.write(connections[topic], round(frame.stamp_s * 1e9), STORE.serialize_cdr(message, kind))
    return folder


def _said(frame: LidarFrame) -> Iterable[tuple[str, Any]]:
    if frame.gnss is not None:
        yield "/gnss/fix", _fix(frame.stamp_s, frame.gnss)
        if frame.gnss.heading_rad is not None:
            yield "/imu/data", _imu(frame.stamp_s, yaw_from_heading(frame.gnss.heading_rad))
    if frame.odom_from_vehicle is not None:
        yield "/odom", _odometry(frame.stamp_s, frame.odom_from_vehicle, frame.speed_mps or 0.0)
    yield "/lidar/points", _cloud(frame)


def _of(kind: str, /, **values: Any) -> Any:
    return STORE.types[kind](**values)


def _header(stamp_s: float, frame: str) -> Any:
    seconds, nanoseconds = divmod(round(stamp_s * 1e9), 10**9)
    stamp = _of("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    return _of("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


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
        orientation_covariance=np.diag([1e-4, 1e-4, HEADING_SD_RAD**2]).ravel(),
        angular_velocity=_vector(0.0, 0.0, 0.0),
        # Minus one: this unit says nothing of it (sensor_msgs/Imu).
        angular_velocity_covariance=np.full(9, -1.0),
        linear_acceleration=_vector(0.0, 0.0, 9.81),
        linear_acceleration_covariance=np.zeros(9),
    )


def _odometry(stamp_s: float, odom_from_vehicle: Matrix, speed_mps: float) -> Any:
    x, y, z = map(float, odom_from_vehicle[:3, 3])
    pose = _of(
        "geometry_msgs/msg/Pose",
        position=_of("geometry_msgs/msg/Point", x=x, y=y, z=z),
        orientation=_quaternion(odom_from_vehicle[:3, :3]),
    )
    twist = _of("geometry_msgs/msg/Twist", linear=_vector(speed_mps, 0.0, 0.0), angular=_vector(0.0, 0.0, 0.0))
    return _of(
        "nav_msgs/msg/Odometry",
        header=_header(stamp_s, "odom"),
        child_frame_id="base_link",
        pose=_of("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
        twist=_of("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
    )


def _quaternion(rotation: Matrix) -> Any:
    x, y, z, w = map(float, Rotation.from_matrix(rotation).as_quat())
    return _of("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _vector(x: float, y: float, z: float) -> Any:
    return _of("geometry_msgs/msg/Vector3", x=x, y=y, z=z)
