"""Where the car is: satellite fixes and odometry joined into one pose, as a pure fold over frames.

Fixes are right on average and shaky, odometry is smooth and drifts. `vehicle_client.positioning.pose_filter` weighs
them; here fixes meet odometry at the moment they were measured, doubtful ones are left out, and what is too unsure is
no pose but a reason. Odometry is never corrected: `enu_from_odom` moves, tracks and accumulated points stay.
"""

from __future__ import annotations

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
    yaw_of,
)
from vehicle_client.positioning import car_estimate, pose_filter
from vehicle_client.positioning.car_estimate import CarEstimate
from vehicle_client.positioning.fix_gate import FixGate, Verdict
from vehicle_client.positioning.heading import FirstFix, StampDelay, measured_yaw, yaw_of_track
from vehicle_client.positioning.odometry_history import (
    ODOMETRY_GAP_S,
    REMEMBERED_S,
    OdometryHistory,
    PlanarPose,
    has_begun_anew,
)
from vehicle_client.positioning.pose_filter import DELAY_SD_S, YAW
from vehicle_client.positioning.speed_scale import measured_scale
from vehicle_client.sources.frame import GnssFix, LidarFrame
from vehicle_client.way_ahead import Bend

STALE_AFTER_S = 60.0
"""Age of the last believed fix after which there is no pose, however little odometry claims to drift."""

DOUBTED_AFTER_S = 2.0
"""While fixes contradict the pose for longer than a reflection lasts, either may be right: there is none."""

LARGEST_SD_M = 5.0
"""Beyond this, a mapped obstacle cannot be told from one in the next lane, nor matched (`alignment.GATE_M`)."""

LARGEST_YAW_SD_RAD = 0.1
"""Places 30 m ahead are then 3 m to the side, a lane."""

MOUNTED_YAW_SD_RAD = math.radians(0.3)
"""How well antennas, inertial units and LiDARs are aligned with the car; no averaging helps."""

WAITING_FIXES = 16
"""Fixes stamped after the frame that brought them: up to a second of a fast receiver."""

ODOMETRY_ALONE = "no satellite fix: odometry from a stated place"


@dataclass(frozen=True, slots=True)
class Pose:
    """Place and attitude of the car at `stamp_s`, in the `enu` frame about `origin`, with what is unsure of it.

    `covariance_m2` (2, 2) is of east and north, and holds the error that all fixes of the last minutes share.
    `speed_mps` is below 0 while the car backs; `bend` is that of the way here.
    """

    stamp_s: float
    origin: GeoOrigin
    enu_from_odom: Matrix
    enu_from_vehicle: Matrix
    covariance_m2: Matrix
    altitude_sd_m: float
    speed_mps: float
    heading_sd_rad: float = MOUNTED_YAW_SD_RAD
    bend: Bend = field(default_factory=Bend)

    @property
    def sd_m(self) -> float:
        """Standard deviation of the place along either axis, on average."""
        return math.sqrt(float(np.trace(self.covariance_m2)) / 2)

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
class PoseUpdate:
    """The pose after a frame, and why nothing may be reported: a pose with a reason is for the driver only."""

    pose: Pose | None
    reason: str | None


@dataclass(frozen=True, slots=True)
class StatedPlace:
    """Where a drive without satellites is said to begin; the heading is clockwise from north."""

    origin: GeoOrigin
    heading_rad: float


@dataclass(frozen=True, slots=True)
class PoseFilter:
    """What the fold remembers. `antenna_m` (3,) is the place on the car that fixes are of which do not say it,
    `delay_sd_s` how well their moments are known."""

    antenna_m: Vector = field(default_factory=lambda: np.zeros(3))
    delay_sd_s: float = DELAY_SD_S
    stated: StatedPlace | None = None
    estimate: CarEstimate | None = None
    history: OdometryHistory = field(default_factory=OdometryHistory)
    gate: FixGate = field(default_factory=FixGate)
    first: FirstFix | None = None
    waiting: tuple[GnssFix, ...] = ()
    last_fix_s: float = -math.inf
    last_yaw_s: float = -math.inf
    clock_off_s: float | None = None
    """By how much the last fix's stamp was beyond belief."""


def update(state: PoseFilter, frame: LidarFrame) -> tuple[PoseFilter, PoseUpdate]:
    """Fold one frame in: odometry to its moment, then the fixes measured until then, also late and out of order.

    Odometry or a fix that is not finite counts as none.
    """
    odom_from_vehicle = frame.odom_from_vehicle
    if odom_from_vehicle is None or not np.isfinite(odom_from_vehicle).all() or not math.isfinite(frame.stamp_s):
        return state, PoseUpdate(None, "no odometry")
    state = _moved(state, frame.stamp_s, odom_from_vehicle)
    state, fixes = _measured_by_now(state, frame)
    for fix in fixes:
        state = _with_fix(state, fix, _stamp(fix, frame))
    if state.estimate is None and state.stated is not None:
        begun = car_estimate.begun_at_stated_place(state.stated.origin, state.stated.heading_rad)
        state = replace(state, estimate=begun)
    reason = _reason_for_none(state, frame.stamp_s)
    if state.estimate is None or reason is not None:
        return state, PoseUpdate(None, reason)
    here = _pose(state.estimate, state.history, frame, odom_from_vehicle)
    return state, PoseUpdate(here, None if state.stated is None else ODOMETRY_ALONE)


def _moved(state: PoseFilter, stamp_s: float, odom_from_vehicle: Matrix) -> PoseFilter:
    history = state.history.with_pose(stamp_s, odom_from_vehicle)
    if not state.history.poses or state.estimate is None:
        return replace(state, history=history)
    before, now = state.history.poses[-1], history.poses[-1]
    elapsed_s = now.stamp_s - before.stamp_s
    moved_m = float(np.linalg.norm(now.place_m - before.place_m))
    if elapsed_s > ODOMETRY_GAP_S or has_begun_anew(moved_m, elapsed_s):
        return _anew(state, OdometryHistory((now,)))
    return replace(state, history=history, estimate=car_estimate.moved(state.estimate, before, now))


def _anew(state: PoseFilter, history: OdometryHistory) -> PoseFilter:
    """What is left of the car, and its odometry; also of a stated place, since nobody knows the way from there."""
    return PoseFilter(antenna_m=state.antenna_m, delay_sd_s=state.delay_sd_s, history=history)


def _stamp(fix: GnssFix, frame: LidarFrame) -> float:
    return frame.stamp_s if fix.stamp_s is None else fix.stamp_s


def _measured_by_now(state: PoseFilter, frame: LidarFrame) -> tuple[PoseFilter, list[GnssFix]]:
    """The fixes whose moment odometry has reached, in the order of time; later ones wait, impossible ones are left."""
    known = [*state.waiting, *(fix for fix in frame.fixes if _is_finite(fix))]
    due, waiting, off_s = [], [], state.clock_off_s
    for fix in known:
        age_s = frame.stamp_s - _stamp(fix, frame)
        if abs(age_s) > REMEMBERED_S:
            off_s = age_s
        elif age_s < 0:
            waiting.append(fix)
        else:
            due.append(fix)
            off_s = None
    due.sort(key=lambda fix: _stamp(fix, frame))
    return replace(state, waiting=tuple(waiting[-WAITING_FIXES:]), clock_off_s=off_s), due


def _is_finite(fix: GnssFix) -> bool:
    stamp_s = 0.0 if fix.stamp_s is None else fix.stamp_s
    return bool(np.isfinite([fix.altitude_m, fix.sd_m, fix.altitude_sd_m, stamp_s]).all()) and fix.sd_m > 0


def _with_fix(state: PoseFilter, fix: GnssFix, stamp_s: float) -> PoseFilter:
    at = state.history.at(stamp_s)
    if at is None or stamp_s == state.last_fix_s:
        return state
    gate, frozen = state.gate.sees(fix.position, at.place_m)
    state = replace(state, gate=gate)
    if frozen:
        return state
    if state.estimate is None or state.stated is not None:
        return _begun(replace(state, stated=None), fix, at)
    estimate = car_estimate.anchored(state.estimate)
    expected = car_estimate.expectation(estimate, fix, at, state.history, _antenna(state, fix))
    innovation_m, covariance_m2 = pose_filter.innovation(estimate.plane, expected)
    gate, verdict = gate.judges(stamp_s, innovation_m, covariance_m2, fix.sd_m)
    state = replace(state, gate=gate, estimate=estimate)
    if verdict is Verdict.REJECTED:
        return state
    if verdict is Verdict.LOST:
        return _begun(_anew(state, state.history), fix, at)
    if verdict is Verdict.AGREED:
        estimate = car_estimate.jumped(estimate, expected)
    else:
        elapsed_s = max(0.0, stamp_s - state.last_fix_s)
        estimate = car_estimate.with_place(estimate, expected, elapsed_s)
    return _with_the_rest(replace(state, estimate=estimate, last_fix_s=stamp_s), estimate, fix, at)


def _antenna(state: PoseFilter, fix: GnssFix) -> Vector:
    return state.antenna_m if fix.antenna_m is None else np.array(fix.antenna_m)


def _with_the_rest(state: PoseFilter, estimate: CarEstimate, fix: GnssFix, at: PlanarPose) -> PoseFilter:
    estimate = car_estimate.with_altitude(estimate, fix, at, state.history.poses[-1], _antenna(state, fix))
    yaw = measured_yaw(fix, at, state.history, state.last_yaw_s, estimate.delay)
    if yaw is None:
        return replace(state, estimate=estimate)
    scale = measured_scale(fix, at, state.history, at.stamp_s - state.last_yaw_s)
    if scale is not None:
        estimate = car_estimate.with_scale(estimate, scale)
    return replace(state, estimate=car_estimate.with_yaw(estimate, yaw), last_yaw_s=at.stamp_s)


def _begun(state: PoseFilter, fix: GnssFix, at: PlanarPose) -> PoseFilter:
    """An estimate at a fix, once the heading is known: said, from the course, or from the way since the first fix."""
    now = state.history.poses[-1]
    yaw = measured_yaw(fix, at, state.history, -math.inf, StampDelay(0.0, state.delay_sd_s))
    if yaw is None and state.first is not None:
        yaw = yaw_of_track(state.first, fix, at, now)
    if yaw is None or yaw.sd_rad > LARGEST_YAW_SD_RAD:
        first = state.first if state.first is not None and state.first.is_near(at) else FirstFix(fix, at)
        return replace(state, estimate=None, first=first)
    begun = car_estimate.begun(fix, at, state.history, yaw, _antenna(state, fix), state.delay_sd_s)
    return replace(state, estimate=begun, first=None, last_fix_s=at.stamp_s, last_yaw_s=at.stamp_s)


def _reason_for_none(state: PoseFilter, stamp_s: float) -> str | None:
    if state.stated is not None:
        return None if state.estimate is None else _reason_to_doubt(state.estimate)
    age_s = stamp_s - state.last_fix_s
    if state.clock_off_s is not None and age_s > DOUBTED_AFTER_S:
        return f"the satellite fixes' clock is {abs(state.clock_off_s):.0f} s off"
    if state.estimate is None:
        return "no satellite fix yet" if state.first is None else "heading unknown: drive on"
    if age_s > STALE_AFTER_S:
        return f"the last satellite fix is {age_s:.0f} s old"
    refused_s = state.gate.last_refused_s
    if refused_s is not None and refused_s - state.last_fix_s > DOUBTED_AFTER_S:
        return "satellite fixes contradict odometry"
    return _reason_to_doubt(state.estimate)


def _reason_to_doubt(estimate: CarEstimate) -> str | None:
    covariance = estimate.plane.state_covariance
    sd_m = math.sqrt(float(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    if sd_m > LARGEST_SD_M:
        return f"place unsure by {sd_m:.0f} m"
    return "heading unsure: drive on" if covariance[YAW, YAW] > LARGEST_YAW_SD_RAD**2 else None


def _pose(estimate: CarEstimate, history: OdometryHistory, frame: LidarFrame, odom_from_vehicle: Matrix) -> Pose:
    covariance = estimate.plane.state_covariance
    rotation = rotation_about_z(estimate.yaw_rad - yaw_of(odom_from_vehicle))
    enu_from_odom = rigid(rotation, estimate.place_m - rotation @ odom_from_vehicle[:3, 3])
    return Pose(
        stamp_s=frame.stamp_s,
        origin=estimate.origin,
        enu_from_odom=enu_from_odom,
        enu_from_vehicle=enu_from_odom @ odom_from_vehicle,
        covariance_m2=covariance[:2, :2],
        altitude_sd_m=estimate.height.sd_m,
        speed_mps=_speed_mps(history.speed_mps, frame.speed_mps),
        heading_sd_rad=math.hypot(math.sqrt(float(covariance[YAW, YAW])), MOUNTED_YAW_SD_RAD),
        bend=history.bend,
    )


def _speed_mps(driven_mps: float, stated_mps: float | None) -> float:
    """The stated speed, if there is one; many a car states one without a sign."""
    if stated_mps is None:
        return driven_mps
    return -abs(stated_mps) if driven_mps < 0 else stated_mps
