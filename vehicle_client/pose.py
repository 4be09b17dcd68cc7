"""Where the car is: satellite fixes and odometry joined into one pose, as a pure fold over frames.

Fixes are right on average and shaky, odometry is smooth and drifts. The transform `enu_from_odom` between the two is
therefore averaged over the last fixes; what it says now is the pose. Its error is that of the fixes' common bias, which
averaging cannot remove, so the reported standard deviation stays that of a fix.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, field, replace

import numpy as np

from contract.geometry import LatLon
from vehicle_client.frames import (
    GeoOrigin,
    Matrix,
    Vector,
    apply,
    heading_from_yaw,
    inverse,
    rigid,
    rotation_about_z,
    yaw_from_heading,
    yaw_of,
)
from vehicle_client.sources.frame import GnssFix, LidarFrame

WINDOW_FIXES = 100
"""Fixes that the average remembers: 10 s at 10 Hz, over which odometry drifts by decimetres at most."""

ANCHOR_M = 1_000.0
"""Distance after which the origin follows the car: north turns by 0.3 mrad over it at 60 degrees of latitude, which
displaces a pose by centimetres; over 50 km it would be by 2 m."""

STALE_AFTER_S = 2.0
"""Age of the last fix after which there is no pose: no report and no overlay."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Place and attitude of the car at `stamp_s`, in the `enu` frame about `origin`."""

    stamp_s: float
    origin: GeoOrigin
    enu_from_odom: Matrix
    enu_from_vehicle: Matrix
    sd_m: float
    altitude_sd_m: float
    speed_mps: float

    @property
    def heading_rad(self) -> float:
        """Heading clockwise from north."""
        return heading_from_yaw(yaw_of(self.enu_from_vehicle))

    @property
    def position(self) -> LatLon:
        """WGS 84 position of the vehicle frame's origin."""
        return self.origin.geodetic(self.enu_from_vehicle[:3, 3])[0]

    @property
    def altitude_m(self) -> float:
        """Ellipsoidal height of the road below the sensor."""
        return self.origin.geodetic(self.enu_from_vehicle[:3, 3])[1]

    @property
    def odom_from_vehicle(self) -> Matrix:
        """(4, 4) pose of the car in `odom`."""
        return inverse(self.enu_from_odom) @ self.enu_from_vehicle

    def in_vehicle(self, position: LatLon, altitude_m: float) -> Vector:
        """A WGS 84 position in the `vehicle` frame, (3,)."""
        return apply(inverse(self.enu_from_vehicle), self.origin.enu(position, altitude_m))


@dataclass(frozen=True, slots=True)
class PoseFilter:
    """What the fold remembers: running means of the fixes and of the odometry at the same moments."""

    origin: GeoOrigin | None = None
    fixes: int = 0
    mean_enu_m: Vector = field(default_factory=lambda: np.zeros(3))
    mean_odom_m: Vector = field(default_factory=lambda: np.zeros(3))
    mean_turn: complex = 0j
    """Mean of exp(i (yaw in enu - yaw in odom)): an average of angles that has no seam."""
    last_fix: GnssFix | None = None
    last_fix_s: float = -math.inf


def update(state: PoseFilter, frame: LidarFrame) -> tuple[PoseFilter, Pose | None]:
    """Fold one frame in. The pose is None without odometry, without a fix, or when the last fix is stale.

    Odometry or a fix that is not finite counts as none.
    """
    if frame.odom_from_vehicle is None or not np.isfinite(frame.odom_from_vehicle).all():
        return state, None
    if frame.gnss is not None and _is_finite(frame.gnss):
        state = _with_fix(state, frame.gnss, frame.odom_from_vehicle, frame.stamp_s)
    if state.origin is None or state.last_fix is None or frame.stamp_s - state.last_fix_s > STALE_AFTER_S:
        return state, None
    rotation = rotation_about_z(cmath.phase(state.mean_turn))
    enu_from_odom = rigid(rotation, state.mean_enu_m - rotation @ state.mean_odom_m)
    pose = Pose(
        stamp_s=frame.stamp_s,
        origin=state.origin,
        enu_from_odom=enu_from_odom,
        enu_from_vehicle=enu_from_odom @ frame.odom_from_vehicle,
        sd_m=state.last_fix.sd_m,
        altitude_sd_m=state.last_fix.altitude_sd_m,
        speed_mps=frame.speed_mps or 0.0,
    )
    return state, pose


def _is_finite(fix: GnssFix) -> bool:
    return fix.heading_rad is not None and bool(
        np.isfinite([fix.altitude_m, fix.heading_rad, fix.sd_m, fix.altitude_sd_m]).all()
    )


def _with_fix(state: PoseFilter, fix: GnssFix, odom_from_vehicle: Matrix, stamp_s: float) -> PoseFilter:
    origin, mean_enu_m = _anchored(state, fix)
    count = min(state.fixes + 1, WINDOW_FIXES)
    turn = cmath.exp(1j * (yaw_from_heading(fix.heading_rad or 0.0) - yaw_of(odom_from_vehicle)))
    enu = origin.enu(fix.position, fix.altitude_m)
    return replace(
        state,
        origin=origin,
        fixes=count,
        mean_enu_m=mean_enu_m + (enu - mean_enu_m) / count,
        mean_odom_m=state.mean_odom_m + (odom_from_vehicle[:3, 3] - state.mean_odom_m) / count,
        mean_turn=state.mean_turn + (turn - state.mean_turn) / count,
        last_fix=fix,
        last_fix_s=stamp_s,
    )


def _anchored(state: PoseFilter, fix: GnssFix) -> tuple[GeoOrigin, Vector]:
    """The origin, moved to the fix when that is far away, and the mean of the fixes (3,) about it."""
    here = GeoOrigin(fix.position, fix.altitude_m)
    if state.origin is None:
        return here, state.mean_enu_m
    if np.linalg.norm(state.origin.enu(fix.position, fix.altitude_m)) < ANCHOR_M:
        return state.origin, state.mean_enu_m
    return here, here.enu(*state.origin.geodetic(state.mean_enu_m))
