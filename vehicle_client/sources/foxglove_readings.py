"""Foxglove's messages (and our own JSON) as readings. The inverse of what the simulator and our recorder write."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry as OdometryMessage
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError, Message

from vehicle_client.sources.checked_values import checked_fix, checked_pose, checked_stamp, finite
from vehicle_client.sources.frame import Motion, SourceError
from vehicle_client.sources.pictures import decode_picture
from vehicle_client.sources.point_fields import record_type, sweep_of
from vehicle_client.sources.raw_pictures import raw_picture
from vehicle_client.sources.readings import Heading, Odometry, Picture, Reading, Steering
from vehicle_client.sources.topics import Decode, Role

ELEMENT_TYPES = {
    PackedElementField.UINT8: "u1",
    PackedElementField.INT8: "i1",
    PackedElementField.UINT16: "<u2",
    PackedElementField.INT16: "<i2",
    PackedElementField.UINT32: "<u4",
    PackedElementField.INT32: "<i4",
    PackedElementField.FLOAT32: "<f4",
    PackedElementField.FLOAT64: "<f8",
}


OWN_METADATA = ("heading_rad", "course_rad", "speed_mps")


def point_cloud(log_s: float, data: bytes) -> list[Reading]:
    """foxglove.PointCloud, in the frame of the sensor."""
    message = _parsed(PointCloud, data)
    kinds = {f.name: (ELEMENT_TYPES[f.type], f.offset) for f in message.fields if f.type in ELEMENT_TYPES}
    kind = record_type(kinds, message.point_stride)
    if len(message.data) % kind.itemsize:
        raise SourceError(f"{len(message.data)} bytes are not whole points of {kind.itemsize} bytes")
    return [sweep_of(_stamp(message, log_s), np.frombuffer(message.data, dtype=kind))]


def compressed_image(log_s: float, data: bytes) -> list[Reading]:
    """foxglove.CompressedImage: JPEG or PNG."""
    message = _parsed(CompressedImage, data)
    return [Picture(_stamp(message, log_s), lambda: decode_picture(message.data))]


def raw_image(log_s: float, data: bytes) -> list[Reading]:
    """foxglove.RawImage."""
    message = _parsed(RawImage, data)
    said = (message.width, message.height, message.step, message.encoding, message.data)
    return [Picture(_stamp(message, log_s), lambda: raw_picture(*said))]


def location_fix(log_s: float, data: bytes) -> list[Reading]:
    """foxglove.LocationFix, with what our recorder puts in its metadata."""
    message = _parsed(LocationFix, data)
    known = message.position_covariance_type != LocationFix.UNKNOWN
    place = (message.latitude, message.longitude, message.altitude)
    fix = checked_fix(_stamp(message, log_s), place, list(message.position_covariance) if known else [])
    said = {pair.key: pair.value for pair in message.metadata}
    heading_rad, course_rad, speed_mps = (_number(said[key]) if key in said else None for key in OWN_METADATA)
    return [replace(fix, heading_rad=heading_rad, course_rad=course_rad, speed_mps=speed_mps)]


def odometry(log_s: float, data: bytes) -> list[Reading]:
    """foxglove.Odometry, of the `vehicle` frame."""
    message = _parsed(OdometryMessage, data)
    at, turn = message.pose.position, message.pose.orientation
    pose = checked_pose((at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w))
    speed_mps = finite(message.linear_velocity.x) if message.HasField("linear_velocity") else None
    return [Odometry(_stamp(message, log_s), pose, speed_mps)]


def inertia(log_s: float, data: bytes) -> list[Reading]:
    """Our JSON headsup.Imu: rates about the unit's axes, and a compass."""
    said = _json(data)
    readings: list[Reading] = []
    if isinstance(said.get("gyroscope_radps"), dict):
        readings.append(Motion(log_s, None, finite(said["gyroscope_radps"].get("z"))))
    if said.get("compass_rad") is not None:
        readings.append(Heading(log_s, finite(said["compass_rad"]) % (2 * math.pi)))
    return readings


def vehicle_state(log_s: float, data: bytes) -> list[Reading]:
    """Our JSON headsup.VehicleState: speed, yaw rate and steering, each where it is known."""
    said = _json(data)
    speed, rate, steering = (said.get(name) for name in ("speed_mps", "yaw_rate_rps", "steering_rad"))
    readings: list[Reading] = []
    if speed is not None or rate is not None:
        speed_mps, yaw_rate_rps = (None if value is None else finite(value) for value in (speed, rate))
        readings.append(Motion(log_s, speed_mps, yaw_rate_rps))
    if steering is not None:
        readings.append(Steering(log_s, finite(steering)))
    return readings


DECODERS: Mapping[tuple[str, str], tuple[Role, Decode]] = {
    ("protobuf", "foxglove.PointCloud"): (Role.SWEEP, point_cloud),
    ("protobuf", "foxglove.CompressedImage"): (Role.IMAGE, compressed_image),
    ("protobuf", "foxglove.RawImage"): (Role.IMAGE, raw_image),
    ("protobuf", "foxglove.LocationFix"): (Role.FIX, location_fix),
    ("protobuf", "foxglove.Odometry"): (Role.ODOMETRY, odometry),
    ("json", "headsup.Imu"): (Role.IMU, inertia),
    ("json", "headsup.VehicleState"): (Role.MOTION, vehicle_state),
}
"""By the message's encoding and the schema's name."""


def _parsed(kind: Any, data: bytes) -> Any:
    message: Message = kind()
    try:
        message.ParseFromString(data)
    except DecodeError as error:
        raise SourceError(f"not a {kind.DESCRIPTOR.full_name}: {error}") from error
    return message


def _stamp(message: Any, log_s: float) -> float:
    return checked_stamp(message.timestamp.seconds + message.timestamp.nanos / 1e9, log_s)


def _number(text: str) -> float:
    try:
        return finite(float(text))
    except ValueError as error:
        raise SourceError(f"{text[:40]} is not a number") from error


def _json(data: bytes) -> dict[str, Any]:
    try:
        said = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise SourceError(f"not JSON: {error}") from error
    if not isinstance(said, dict):
        raise SourceError("expected a JSON object")
    return said
