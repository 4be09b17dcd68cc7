"""Poses, obstacles, tracks and maps for the vehicle's tests."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from uuid import UUID

import numpy as np

from contract.geometry import Box, BoxSd, Kind, LatLon, PlaneCovariance
from contract.observation import State
from contract.obstacle import ObstacleFeature, ObstacleProperties, PointGeometry
from detector.types import DetectedObstacle, ObstacleKind, ShapeDescriptor
from vehicle_client.area import Area, Surveyed
from vehicle_client.frames import GeoOrigin, Matrix, inverse, rigid, rotation_about_z, yaw_from_heading
from vehicle_client.obstacle_map import ObstacleMap, apply
from vehicle_client.positioning.pose import Pose
from vehicle_client.sensing.calibration import CameraCalibration
from vehicle_client.tracking import Track

PATRAS = LatLon(latitude_deg=38.2466, longitude_deg=21.7346)
ORIGIN = GeoOrigin(PATRAS, 20.0)
NOON = datetime(2026, 6, 1, 12, tzinfo=UTC)
NOON_S = NOON.timestamp()

CAMERA_AXES_IN_VEHICLE = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def camera_ahead(width_px: int, height_px: int, fov_deg: float) -> CameraCalibration:
    """A camera 1.3 m over the road, 1.5 m before the middle of the car, that looks ahead."""
    focal_px = width_px / 2 / math.tan(math.radians(fov_deg) / 2)
    matrix = np.array([[focal_px, 0, width_px / 2], [0, focal_px, height_px / 2], [0, 0, 1]])
    return CameraCalibration(matrix, width_px, height_px, rigid(CAMERA_AXES_IN_VEHICLE, np.array([1.5, 0.0, 1.3])))


def planar(x_m: float, y_m: float, yaw_rad: float, z_m: float = 0.0) -> Matrix:
    return rigid(rotation_about_z(yaw_rad), np.array([x_m, y_m, z_m]))


def pose_at(
    east_m: float = 0.0,
    north_m: float = 0.0,
    heading_rad: float = math.pi / 2,
    *,
    speed_mps: float = 10.0,
    odom_from_vehicle: Matrix | None = None,
    origin: GeoOrigin = ORIGIN,
    stamp_s: float = NOON_S,
    sd_m: float = 1.0,
) -> Pose:
    """A car at a place of the `enu` frame; unless said otherwise its `odom` is that `enu` frame."""
    enu_from_vehicle = planar(east_m, north_m, yaw_from_heading(heading_rad))
    odom = enu_from_vehicle if odom_from_vehicle is None else odom_from_vehicle
    covariance_m2 = sd_m**2 * np.eye(2)
    return Pose(stamp_s, origin, enu_from_vehicle @ inverse(odom), enu_from_vehicle, covariance_m2, 2.0, speed_mps)


def feature(
    number: int = 1,
    east_m: float = 0.0,
    north_m: float = 0.0,
    *,
    revision: int = 1,
    kind: Kind = Kind.POTHOLE,
    yaw_rad: float = 0.0,
    length_mm: int = 900,
    width_mm: int = 700,
    lives: timedelta = timedelta(days=60),
    origin: GeoOrigin = ORIGIN,
) -> ObstacleFeature:
    """An obstacle as the server tells it, at a place of the `enu` frame."""
    position, altitude_m = origin.geodetic(np.array([east_m, north_m, 0.0]))
    properties = ObstacleProperties(
        kind=kind,
        sign=kind.sign,
        state=State.CONFIRMED,
        version=1,
        revision=revision,
        box=Box(length_mm=length_mm, width_mm=width_mm, yaw_rad=yaw_rad, relief_mm=100),
        box_sd=BoxSd(ln_length=0.05, ln_width=0.05, ln_area=0.07, relief_mm=5),
        volume_m3=0.03,
        position_covariance=PlaneCovariance(east_m2=0.25, north_m2=0.25),
        altitude_m=altitude_m,
        confidence=0.8,
        as_of=NOON,
        half_life_s=2_592_000.0,
        expires_at=NOON + lives,
        first_seen=NOON - timedelta(days=1),
        last_seen=NOON,
        sightings=3,
        witnesses=2,
    )
    return ObstacleFeature(id=UUID(int=number), geometry=PointGeometry.at(position), properties=properties)


def map_of(*features: ObstacleFeature, heard_s: float = NOON_S) -> ObstacleMap:
    return apply(ObstacleMap(), Surveyed(Area(PATRAS, 5_000.0), features), heard_s)


def seen(
    x_m: float = 10.0,
    y_m: float = 0.0,
    kind: ObstacleKind = ObstacleKind.POTHOLE,
    *,
    z_m: float = -1.7,
    yaw_rad: float = 0.3,
    length_m: float = 0.9,
    width_m: float = 0.7,
    covariance_m2: Matrix | None = None,
    points_m: Sequence[tuple[float, float, float]] = ((0.1, 0.0, -0.05), (0.0, -0.2, 0.0)),
) -> DetectedObstacle:
    """An obstacle as the detector gives it."""
    return DetectedObstacle(
        kind=kind,
        centre_m=np.array([x_m, y_m, z_m]),
        length_m=length_m,
        width_m=width_m,
        yaw_rad=yaw_rad,
        relief_m=0.1,
        volume_m3=0.03,
        confidence=0.8,
        hits=200,
        frames=10,
        least_range_m=4.0,
        view_front=True,
        view_rear=True,
        ln_length_sd=0.03,
        ln_width_sd=0.03,
        ln_area_sd=0.04,
        relief_sd_m=0.004,
        centre_covariance_m2=np.diag([0.01, 0.0025]) if covariance_m2 is None else covariance_m2,
        descriptor=ShapeDescriptor("shape", 1, {"area_m2": 0.5}),
        points_m=np.array(points_m, dtype=np.float32).reshape(-1, 3),
    )


def track_at(
    x_m: float,
    y_m: float,
    track_id: int = 1,
    *,
    kind: ObstacleKind = ObstacleKind.POTHOLE,
    sightings: int = 3,
    moved_m: float = 0.0,
) -> Track:
    """A track at a place of `odom`, which it has come to from `moved_m` away."""
    return Track(
        track_id=track_id,
        centre_odom_m=np.array([x_m, y_m, 0.0]),
        is_negative=kind.is_negative,
        bump_votes=int(kind is ObstacleKind.BUMP),
        debris_votes=int(kind is ObstacleKind.DEBRIS),
        length_m=0.9,
        width_m=0.7,
        relief_m=0.1,
        yaw_rad=0.0,
        sightings=sightings,
        first_stamp_s=0.0,
        first_range_m=20.0,
        last_stamp_s=1.0,
        looks=sightings,
        was_ahead=True,
        first_m=(np.array([x_m - moved_m, y_m]),),
        latest_m=(np.array([x_m, y_m]),),
    )
