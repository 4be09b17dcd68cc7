"""ROS messages as readings. `types` deserialises; definitions are the standard ones, never those a file brings."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from vehicle_client.frames import heading_from_yaw, yaw_of
from vehicle_client.sources.checked_values import checked_fix, checked_pose, checked_stamp, finite
from vehicle_client.sources.frame import Motion, SourceError
from vehicle_client.sources.pictures import decode_picture
from vehicle_client.sources.point_fields import MOST_POINTS, record_type, sweep_of
from vehicle_client.sources.raw_pictures import raw_picture
from vehicle_client.sources.readings import GroundVelocity, Heading, Odometry, Picture, Reading
from vehicle_client.sources.topics import Decode, Role

DATA_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""sensor_msgs/PointField."""

HEADING_SD_RAD = 0.2
"""An inertial unit that states a worse heading, or none, is not asked: many count theirs from where they started."""

OF_THE_EARTH = ("gnss", "gps", "navsat", "fix", "enu")
"""Words in the name of a velocity's topic or frame that make it one over ground rather than of the car's body."""

SENSELESS = (SerdeError, struct.error, ValueError, LookupError, TypeError, OverflowError, MemoryError)
"""What the deserialiser raises where bytes make no sense."""


def point_cloud(log_s: float, message: Any) -> list[Reading]:
    """sensor_msgs/PointCloud2 with any fields, of either byte order, with or without padded rows."""
    order = ">" if message.is_bigendian else "<"
    kinds = {
        field.name: (order + DATA_TYPES[field.datatype], field.offset)
        for field in message.fields
        if field.count == 1 and field.datatype in DATA_TYPES
    }
    kind = record_type(kinds, message.point_step)
    height, width, row_bytes = message.height, message.width, message.row_step
    if not 0 < width * height <= MOST_POINTS:
        raise SourceError(f"{width} x {height} points are no sweep")
    data = np.asarray(message.data, dtype=np.uint8)
    if height == 1:
        row_bytes = width * kind.itemsize  # some drivers leave it at 0
    if row_bytes < width * kind.itemsize or len(data) < row_bytes * height:
        raise SourceError(f"announces {width} x {height} points of {kind.itemsize} bytes, holds {len(data)} bytes")
    rows = np.ascontiguousarray(data[: row_bytes * height].reshape(height, row_bytes)[:, : width * kind.itemsize])
    return [sweep_of(_stamp(message, log_s), rows.reshape(-1).view(kind))]


def navsat_fix(log_s: float, message: Any) -> list[Reading]:
    """sensor_msgs/NavSatFix; nothing where the receiver says that it has no fix."""
    if message.status.status < 0:
        return []
    place = (float(message.latitude), float(message.longitude), float(message.altitude))
    covariance = [float(v) for v in message.position_covariance] if message.position_covariance_type else []
    return [checked_fix(_stamp(message, log_s), place, covariance)]


def imu(log_s: float, message: Any) -> list[Reading]:
    """sensor_msgs/Imu, mounted as the car points (REP 103): the yaw rate, and a heading whose variance is stated."""
    stamp_s = _stamp(message, log_s)
    readings: list[Reading] = []
    if message.angular_velocity_covariance[0] != -1:
        readings.append(Motion(stamp_s, None, finite(float(message.angular_velocity.z))))
    variance = float(message.orientation_covariance[8])
    if message.orientation_covariance[0] != -1 and 0 < variance <= HEADING_SD_RAD**2:
        turn = message.orientation
        enu_from_vehicle = checked_pose((0, 0, 0), (turn.x, turn.y, turn.z, turn.w))
        readings.append(Heading(stamp_s, heading_from_yaw(yaw_of(enu_from_vehicle))))
    return readings


def image(log_s: float, message: Any) -> list[Reading]:
    """sensor_msgs/Image."""
    said = (message.width, message.height, message.step, message.encoding, message.data)
    return [Picture(_stamp(message, log_s), lambda: raw_picture(*said))]


def compressed_image(log_s: float, message: Any) -> list[Reading]:
    """sensor_msgs/CompressedImage: JPEG or PNG."""
    return [Picture(_stamp(message, log_s), lambda: decode_picture(bytes(message.data)))]


def odometry(log_s: float, message: Any) -> list[Reading]:
    """nav_msgs/Odometry: `odom_from_vehicle`, and the speed forward."""
    at, turn = message.pose.pose.position, message.pose.pose.orientation
    pose = checked_pose((at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w))
    return [Odometry(_stamp(message, log_s), pose, finite(float(message.twist.twist.linear.x)))]


def twist(log_s: float, message: Any) -> list[Reading]:
    """geometry_msgs/TwistStamped (and WithCovariance) of the car's body: speed forward and yaw rate."""
    velocity = _twist(message)
    speed_mps, rate_rps = finite(float(velocity.linear.x)), finite(float(velocity.angular.z))
    return [Motion(_stamp(message, log_s), speed_mps, rate_rps)]


def ground_velocity(log_s: float, message: Any) -> list[Reading]:
    """The same message of a satellite receiver: velocity east and north."""
    velocity = _twist(message)
    east, north = finite(float(velocity.linear.x)), finite(float(velocity.linear.y))
    course_rad = heading_from_yaw(math.atan2(north, east))
    return [GroundVelocity(_stamp(message, log_s), course_rad, math.hypot(east, north))]


ROLES: Mapping[str, tuple[Role, Callable[[float, Any], list[Reading]]]] = {
    "sensor_msgs/msg/PointCloud2": (Role.SWEEP, point_cloud),
    "sensor_msgs/msg/NavSatFix": (Role.FIX, navsat_fix),
    "sensor_msgs/msg/Imu": (Role.IMU, imu),
    "sensor_msgs/msg/Image": (Role.IMAGE, image),
    "sensor_msgs/msg/CompressedImage": (Role.IMAGE, compressed_image),
    "nav_msgs/msg/Odometry": (Role.ODOMETRY, odometry),
    "geometry_msgs/msg/TwistStamped": (Role.MOTION, twist),
    "geometry_msgs/msg/TwistWithCovarianceStamped": (Role.MOTION, twist),
}


class RosTypes:
    """Decoders for one generation of ROS: CDR bytes of ROS 2, or those of ROS 1."""

    def __init__(self, generation: int) -> None:
        store = get_typestore(Stores.ROS2_HUMBLE if generation == 2 else Stores.ROS1_NOETIC)
        self._deserialize = store.deserialize_cdr if generation == 2 else store.deserialize_ros1

    def decoder(self, topic: str, type_name: str) -> tuple[Role, Decode] | None:
        """What a topic of this type is for and how it is read; None for types that are not needed."""
        if type_name not in ROLES:
            return None
        role, read = ROLES[type_name]
        if role is Role.MOTION and any(word in topic.lower() for word in OF_THE_EARTH):
            role, read = Role.VELOCITY, ground_velocity

        def decode(log_s: float, data: bytes) -> list[Reading]:
            try:
                message = self._deserialize(data, type_name)
            except SENSELESS as error:
                raise SourceError(f"not a {type_name}: {error}") from error
            return read(log_s, message)

        return role, decode


def _stamp(message: Any, log_s: float) -> float:
    stamp = message.header.stamp
    return checked_stamp(stamp.sec + stamp.nanosec / 1e9, log_s)


def _twist(message: Any) -> Any:
    return message.twist.twist if hasattr(message.twist, "twist") else message.twist
