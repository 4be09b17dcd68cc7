"""ROS bags of both generations, written by the library `rosbags`: a car at 10 m/s with a spinning LiDAR."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rosbags.rosbag1
import rosbags.rosbag2
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore

START_NS = 1_780_000_000_000_000_000
PERIOD_NS = 100_000_000
COUNT = 120
RING = (np.arange(COUNT) % 16).astype(np.uint16)
SINCE_START_NS = np.linspace(0, 99_000_000, COUNT).astype(np.uint32)

PLACE = (49.015, 8.4342, 116.0)
YAW_RAD = 0.5

STORES = {1: Stores.ROS1_NOETIC, 2: Stores.ROS2_HUMBLE}


def points(index: int) -> np.ndarray:
    return np.random.default_rng(index).normal(0, 15, (COUNT, 3)).astype(np.float32)


class Messages:
    """Messages of one generation of ROS."""

    def __init__(self, generation: int) -> None:
        self.generation = generation
        self.store = get_typestore(STORES[generation])

    def of(self, kind: str, /, **values: Any) -> Any:
        return self.store.types[kind](**values)

    def header(self, stamp_ns: int, frame: str) -> Any:
        time = self.of("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        extra = {"seq": 0} if self.generation == 1 else {}
        return self.of("std_msgs/msg/Header", stamp=time, frame_id=frame, **extra)

    def cloud(self, index: int, stamp_ns: int, *, big_endian: bool = False, padding: int = 0) -> Any:
        """With rows of 12 points each, `padding` bytes after each row, ring and Ouster's `t`."""
        order = ">" if big_endian else "<"
        kind = np.dtype(
            {
                "names": ["x", "y", "z", "intensity", "t", "ring"],
                "formats": [f"{order}f4", f"{order}f4", f"{order}f4", f"{order}f4", f"{order}u4", f"{order}u2"],
                "offsets": [0, 4, 8, 16, 20, 24],
                "itemsize": 32,
            }
        )
        made = np.zeros(COUNT, dtype=kind)
        made["x"], made["y"], made["z"] = points(index).T
        made["intensity"], made["t"], made["ring"] = 7, SINCE_START_NS, RING
        rows = np.zeros((COUNT // 12, 12 * 32 + padding), dtype=np.uint8)
        rows[:, : 12 * 32] = made.view(np.uint8).reshape(COUNT // 12, -1)
        types = {"f4": 7, "u4": 6, "u2": 4}
        fields = [
            self.of(
                "sensor_msgs/msg/PointField",
                name=name,
                offset=kind.fields[name][1],
                datatype=types[kind[name].str[1:]],
                count=1,
            )
            for name in kind.names
        ]
        return self.of(
            "sensor_msgs/msg/PointCloud2",
            header=self.header(stamp_ns, "lidar_top"),
            height=COUNT // 12,
            width=12,
            fields=fields,
            is_bigendian=big_endian,
            point_step=32,
            row_step=12 * 32 + padding,
            data=rows.reshape(-1),
            is_dense=False,
        )

    def fix(self, stamp_ns: int, status: int = 0) -> Any:
        """A fix of 1.5 m horizontally, 3 m vertically."""
        latitude, longitude, altitude = PLACE
        return self.of(
            "sensor_msgs/msg/NavSatFix",
            header=self.header(stamp_ns, "gps"),
            status=self.of("sensor_msgs/msg/NavSatStatus", status=status, service=1),
            latitude=latitude,
            longitude=longitude,
            altitude=altitude,
            position_covariance=np.diag([2.25, 2.25, 9.0]).ravel(),
            position_covariance_type=2,
        )

    def imu(self, stamp_ns: int, yaw_variance: float = 0.0004) -> Any:
        return self.of(
            "sensor_msgs/msg/Imu",
            header=self.header(stamp_ns, "imu"),
            orientation=self._quaternion(YAW_RAD),
            orientation_covariance=np.diag([0.001, 0.001, yaw_variance]).ravel(),
            angular_velocity=self._vector(0.0, 0.0, 0.1),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=self._vector(0.0, 0.0, 9.8),
            linear_acceleration_covariance=np.zeros(9),
        )

    def odometry(self, stamp_ns: int, x_m: float) -> Any:
        pose = self.of("geometry_msgs/msg/Pose", position=self._point(x_m, 0, 0), orientation=self._quaternion(0.0))
        return self.of(
            "nav_msgs/msg/Odometry",
            header=self.header(stamp_ns, "odom"),
            child_frame_id="base_link",
            pose=self.of("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
            twist=self.of(
                "geometry_msgs/msg/TwistWithCovariance", twist=self._twist(10.0, 0.0, 0.0), covariance=np.zeros(36)
            ),
        )

    def twist(self, stamp_ns: int, x: float, y: float, turning: float) -> Any:
        header = self.header(stamp_ns, "base_link")
        return self.of("geometry_msgs/msg/TwistStamped", header=header, twist=self._twist(x, y, turning))

    def picture(self, stamp_ns: int, grey: int, encoding: str = "rgb8") -> Any:
        pixels = np.zeros((4, 6, 3), dtype=np.uint8)
        pixels[..., 0] = grey
        return self.of(
            "sensor_msgs/msg/Image",
            header=self.header(stamp_ns, "camera"),
            height=4,
            width=6,
            encoding=encoding,
            is_bigendian=0,
            step=18,
            data=pixels.reshape(-1),
        )

    def jpeg(self, stamp_ns: int, grey: int) -> Any:
        _, data = cv2.imencode(".jpg", np.full((8, 8, 3), grey, np.uint8))
        header = self.header(stamp_ns, "camera")
        return self.of("sensor_msgs/msg/CompressedImage", header=header, format="jpeg", data=data.reshape(-1))

    def _vector(self, x: float, y: float, z: float) -> Any:
        return self.of("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=float(z))

    def _point(self, x: float, y: float, z: float) -> Any:
        return self.of("geometry_msgs/msg/Point", x=float(x), y=float(y), z=float(z))

    def _quaternion(self, yaw: float) -> Any:
        return self.of("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))

    def _twist(self, x: float, y: float, turning: float) -> Any:
        linear, angular = self._vector(x, y, 0.0), self._vector(0.0, 0.0, turning)
        return self.of("geometry_msgs/msg/Twist", linear=linear, angular=angular)


Said = tuple[str, int, Any]
"""Topic, log time in nanoseconds, message."""


def drive(messages: Messages, frames: int = 4) -> Iterator[Said]:
    """Each sweep is stamped at its begin and logged as it ends; all else as it is measured."""
    for index in range(frames):
        begin = START_NS + index * PERIOD_NS
        yield "/gnss/fix", begin, messages.fix(begin)
        yield "/imu/data", begin + 10_000_000, messages.imu(begin + 10_000_000)
        yield "/imu/data", begin + 60_000_000, messages.imu(begin + 60_000_000)
        yield "/odom", begin + 50_000_000, messages.odometry(begin + 50_000_000, index + 0.5)
        yield "/camera/front/image", begin + 30_000_000, messages.picture(begin + 30_000_000, 100 + index)
        yield "/lidar_top/points", begin + 99_500_000, messages.cloud(index, begin)


def write_bag(
    path: Path,
    generation: int,
    said: list[Said],
    storage: StoragePlugin = StoragePlugin.SQLITE3,
    prepare: Callable[[Any], None] = lambda writer: None,
) -> Path:
    """A bag of these messages."""
    store = get_typestore(STORES[generation])
    writer: Any
    if generation == 1:
        writer = rosbags.rosbag1.Writer(path)
    else:
        writer = rosbags.rosbag2.Writer(path, version=8, storage_plugin=storage)
    prepare(writer)
    with writer:
        connections: dict[str, Any] = {}
        for topic, log_ns, message in sorted(said, key=lambda row: row[1]):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            serialize = store.serialize_ros1 if generation == 1 else store.serialize_cdr
            writer.write(connections[topic], log_ns, serialize(message, kind))
    return path
