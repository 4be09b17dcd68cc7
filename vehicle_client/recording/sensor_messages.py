"""What the sensors measured as Foxglove's messages, so that the recording is a source again."""

from __future__ import annotations

import cv2
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from detector.types import FrameDetection
from vehicle_client.frames import Matrix
from vehicle_client.positioning.pose import Pose as VehiclePose
from vehicle_client.sources.frame import GnssFix, LidarFrame

JPEG_QUALITY = 90
"""A fifth of the PNG's size, without blocks that an eye would see."""

ELEMENT_TYPES = {
    np.dtype("u1"): PackedElementField.UINT8,
    np.dtype("<u2"): PackedElementField.UINT16,
    np.dtype("<f4"): PackedElementField.FLOAT32,
}


def stamp_ns(stamp_s: float) -> int:
    """Unix time in nanoseconds."""
    return round(stamp_s * 1e9)


def point_cloud(frame: LidarFrame, detection: FrameDetection) -> PointCloud:
    """The sweep with what it came with, and the class and saliency that the detector gave each point."""
    x, y, z = frame.points_m.T
    columns: dict[str, NDArray[np.generic] | None] = {
        "x": x,
        "y": y,
        "z": z,
        "intensity": frame.intensity,
        "time_offset": frame.point_time_s,
        "saliency": detection.saliency,
        "ring": frame.ring,
        "class": detection.labels,
    }
    there = {name: values for name, values in columns.items() if values is not None}
    kind = np.dtype([(name, values.dtype.newbyteorder("<")) for name, values in there.items()], align=True)
    points = np.zeros(len(frame.points_m), dtype=kind)
    for name, values in there.items():
        points[name] = values
    return PointCloud(
        timestamp=timestamp(stamp_ns(frame.stamp_s)),
        frame_id="sensor",
        pose=pose(np.eye(4)),
        point_stride=kind.itemsize,
        fields=[
            PackedElementField(name=name, offset=offset, type=ELEMENT_TYPES[of])
            for name, (of, offset, *_) in (kind.fields or {}).items()
        ],
        data=points.tobytes(),
    )


def jpeg(image: NDArray[np.uint8], time_ns: int, frame_id: str) -> CompressedImage:
    """A BGR picture (H, W, 3)."""
    _, data = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))
    return CompressedImage(timestamp=timestamp(time_ns), frame_id=frame_id, data=data.tobytes(), format="jpeg")


def location_fix(fix: GnssFix, time_ns: int) -> LocationFix:
    """A fix; what Foxglove's message has no unit for stands in its metadata, by our names."""
    said = {"heading_rad": fix.heading_rad, "course_rad": fix.course_rad, "speed_mps": fix.speed_mps}
    return LocationFix(
        timestamp=timestamp(time_ns),
        frame_id="vehicle",
        latitude=fix.position.latitude_deg,
        longitude=fix.position.longitude_deg,
        altitude=fix.altitude_m,
        position_covariance=_diagonal(fix.sd_m, fix.altitude_sd_m),
        position_covariance_type=LocationFix.DIAGONAL_KNOWN,
        metadata=[KeyValuePair(key=key, value=repr(value)) for key, value in said.items() if value is not None],
    )


def pose_fix(at: VehiclePose, time_ns: int) -> LocationFix:
    """Where the car took itself to be, for maps."""
    return LocationFix(
        timestamp=timestamp(time_ns),
        frame_id="vehicle",
        latitude=at.position.latitude_deg,
        longitude=at.position.longitude_deg,
        altitude=at.altitude_m,
        position_covariance=_diagonal(at.sd_m, at.altitude_sd_m),
        position_covariance_type=LocationFix.DIAGONAL_KNOWN,
        metadata=[KeyValuePair(key="heading_rad", value=repr(at.heading_rad))],
    )


def odometry(odom_from_vehicle: Matrix, speed_mps: float | None, time_ns: int) -> Odometry:
    """The pose by odometry, and the speed forward."""
    return Odometry(
        timestamp=timestamp(time_ns),
        frame_id="odom",
        body_frame_id="vehicle",
        pose=pose(odom_from_vehicle),
        linear_velocity=None if speed_mps is None else Vector3(x=speed_mps),
    )


def frame_transform(time_ns: int, parent: str, child: str, parent_from_child: Matrix) -> FrameTransform:
    """Where a frame is in another one."""
    at = pose(parent_from_child)
    return FrameTransform(
        timestamp=timestamp(time_ns),
        parent_frame_id=parent,
        child_frame_id=child,
        translation=at.position,
        rotation=at.orientation,
    )


def pose(a_from_b: Matrix) -> Pose:
    """A (4, 4) rigid transform."""
    x, y, z = a_from_b[:3, 3].tolist()
    qx, qy, qz, qw = Rotation.from_matrix(a_from_b[:3, :3]).as_quat().tolist()
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def timestamp(time_ns: int) -> Timestamp:
    """Unix time in nanoseconds."""
    return Timestamp(seconds=time_ns // 1_000_000_000, nanos=time_ns % 1_000_000_000)


def _diagonal(sd_m: float, altitude_sd_m: float) -> list[float]:
    return [sd_m**2, 0.0, 0.0, 0.0, sd_m**2, 0.0, 0.0, 0.0, altitude_sd_m**2]
