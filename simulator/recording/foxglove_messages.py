"""Readings as Foxglove's protobuf messages (foxglove.PointCloud and its kin), and JSON schemas for what it has not."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray

from contract.geometry import Kind
from simulator.readings import GnssReading, ImageReading, ImuReading, ObstacleTruth, Sweep
from simulator.recording.rotation import quaternion

FloatArray = NDArray[np.float64]

POINT = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "time_offset", "obstacle_id", "mover_id", "ring", "surface"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<f4", "<i4", "<i4", "<u2", "u1"],
        "offsets": [0, 4, 8, 12, 16, 20, 24, 28, 30],
        "itemsize": 32,
    }
)
"""A point of the cloud messages; 32 bytes keep the numbers aligned."""

ELEMENT_TYPES = {
    np.dtype("u1"): PackedElementField.UINT8,
    np.dtype("<u2"): PackedElementField.UINT16,
    np.dtype("<i4"): PackedElementField.INT32,
    np.dtype("<f4"): PackedElementField.FLOAT32,
}

CAMERA_FROM_OPTICAL = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""From a camera's mounting (x forward, y left, z up) to the axes of its image (x right, y down, z forward)."""

COLOURS = {
    Kind.POTHOLE: Color(r=1.0, g=0.8, b=0.0, a=0.6),
    Kind.BUMP: Color(r=0.0, g=0.8, b=0.9, a=0.6),
    Kind.DEBRIS: Color(r=0.9, g=0.1, b=0.1, a=0.6),
}

_NUMBER = {"type": "number"}
_VECTOR = {"type": "object", "properties": {"x": _NUMBER, "y": _NUMBER, "z": _NUMBER}}

IMU_SCHEMA = {
    "title": "headsup.Imu",
    "type": "object",
    "properties": {"accelerometer_mps2": _VECTOR, "gyroscope_radps": _VECTOR, "compass_rad": _NUMBER},
}
VEHICLE_SCHEMA = {
    "title": "headsup.VehicleState",
    "type": "object",
    "properties": {"speed_mps": _NUMBER, "steering_rad": _NUMBER, "frame": {"type": "integer"}},
}


def point_cloud(time_ns: int, frame_id: str, sweep: Sweep) -> PointCloud:
    """A sweep with intensity, time, ring and the labels of each point; right-handed sensor frame."""
    points = np.zeros(len(sweep.points_m), dtype=POINT)
    points["x"], points["y"], points["z"] = sweep.points_m.T
    points["intensity"], points["time_offset"], points["ring"] = sweep.intensity, sweep.time_offset_s, sweep.ring
    points["surface"] = sweep.surface
    points["obstacle_id"], points["mover_id"] = sweep.obstacle_id, sweep.mover_id
    return PointCloud(
        timestamp=_timestamp(time_ns),
        frame_id=frame_id,
        pose=_pose(np.eye(4)),
        point_stride=POINT.itemsize,
        fields=[
            PackedElementField(name=name, offset=offset, type=ELEMENT_TYPES[kind])
            for name, (kind, offset, *_) in (POINT.fields or {}).items()
        ],
        data=points.tobytes(),
    )


def compressed_image(time_ns: int, frame_id: str, data: bytes, kind: str) -> CompressedImage:
    """A picture as `jpeg` or `png`, in its optical frame."""
    return CompressedImage(timestamp=_timestamp(time_ns), frame_id=frame_id, data=data, format=kind)


def camera_calibration(
    time_ns: int, frame_id: str, reading: ImageReading, sensor: Mapping[str, object]
) -> CameraCalibration:
    """A pinhole from CARLA's `fov` (horizontal, degrees; 90 where not given)."""
    height, width = reading.pixels.shape[:2]
    focal = width / 2 / math.tan(math.radians(float(str(sensor.get("fov", 90.0)))) / 2)
    k = [focal, 0.0, width / 2, 0.0, focal, height / 2, 0.0, 0.0, 1.0]
    p = [focal, 0.0, width / 2, 0.0, 0.0, focal, height / 2, 0.0, 0.0, 0.0, 1.0, 0.0]
    r = np.eye(3).ravel().tolist()
    return CameraCalibration(
        timestamp=_timestamp(time_ns), frame_id=frame_id, width=width, height=height, K=k, P=p, R=r
    )


def location_fix(time_ns: int, frame_id: str, reading: GnssReading) -> LocationFix:
    """A satellite fix with the variances that the receiver states."""
    horizontal, vertical = reading.sd_m**2, reading.altitude_sd_m**2
    return LocationFix(
        timestamp=_timestamp(time_ns),
        frame_id=frame_id,
        latitude=reading.position.latitude_deg,
        longitude=reading.position.longitude_deg,
        altitude=reading.altitude_m,
        position_covariance=[horizontal, 0, 0, 0, horizontal, 0, 0, 0, vertical],
        position_covariance_type=LocationFix.DIAGONAL_KNOWN,
    )


def frame_transform(time_ns: int, parent: str, child: str, parent_from_child: FloatArray) -> FrameTransform:
    """Where a frame is in another one."""
    return FrameTransform(
        timestamp=_timestamp(time_ns),
        parent_frame_id=parent,
        child_frame_id=child,
        translation=_vector(parent_from_child[:3, 3]),
        rotation=_quaternion(parent_from_child),
    )


def pose_in_frame(time_ns: int, frame_id: str, frame_from_body: FloatArray) -> PoseInFrame:
    """A body's pose."""
    return PoseInFrame(timestamp=_timestamp(time_ns), frame_id=frame_id, pose=_pose(frame_from_body))


def odometry(time_ns: int, odom_from_vehicle: FloatArray) -> Odometry:
    """What wheels and gyro say of the vehicle."""
    stamp, pose = _timestamp(time_ns), _pose(odom_from_vehicle)
    return Odometry(timestamp=stamp, frame_id="odom", body_frame_id="vehicle", pose=pose)


def imu_json(reading: ImuReading) -> dict[str, Any]:
    """A value of `IMU_SCHEMA`."""
    accelerometer, gyroscope = (
        dict(zip("xyz", values.tolist(), strict=True))
        for values in (reading.accelerometer_mps2, reading.gyroscope_radps)
    )
    return {"accelerometer_mps2": accelerometer, "gyroscope_radps": gyroscope, "compass_rad": reading.compass_rad}


def obstacle_scene(time_ns: int, row: ObstacleTruth) -> SceneUpdate:
    """An obstacle's box in `enu`, or its end: a hole hangs below the road, a thing stands on it."""
    if row.change == "removed":
        gone = SceneEntityDeletion(
            timestamp=_timestamp(time_ns), type=SceneEntityDeletion.MATCHING_ID, id=str(row.obstacle_id)
        )
        return SceneUpdate(deletions=[gone])
    pose = np.eye(4)
    cos, sin = math.cos(row.yaw_rad), math.sin(row.yaw_rad)
    pose[:2, :2] = [[cos, -sin], [sin, cos]]
    sign = -1 if row.kind is Kind.POTHOLE else 1
    pose[:3, 3] = row.enu_m
    pose[2, 3] += sign * row.relief_m / 2
    size = Vector3(x=row.length_m, y=row.width_m, z=row.relief_m)
    entity = SceneEntity(
        timestamp=_timestamp(time_ns),
        frame_id="enu",
        id=str(row.obstacle_id),
        metadata=[KeyValuePair(key="kind", value=row.kind.value), KeyValuePair(key="change", value=row.change)],
        cubes=[CubePrimitive(pose=_pose(pose), size=size, color=COLOURS[row.kind])],
    )
    return SceneUpdate(entities=[entity])


def _timestamp(time_ns: int) -> Timestamp:
    return Timestamp(seconds=time_ns // 1_000_000_000, nanos=time_ns % 1_000_000_000)


def _vector(values: FloatArray) -> Vector3:
    x, y, z = values.tolist()
    return Vector3(x=x, y=y, z=z)


def _quaternion(a_from_b: FloatArray) -> Quaternion:
    x, y, z, w = quaternion(a_from_b)
    return Quaternion(x=x, y=y, z=z, w=w)


def _pose(a_from_b: FloatArray) -> Pose:
    return Pose(position=_vector(a_from_b[:3, 3]), orientation=_quaternion(a_from_b))
