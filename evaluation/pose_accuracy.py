"""How right the pose is, and how honest about it: errors, coverage of the 95 % ellipse, heading and smoothness."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from evaluation.pose_drives import PoseDrive
from vehicle_client.frames import apply, inverse, yaw_of
from vehicle_client.positioning.odometry import Given, Tracker, Wheels
from vehicle_client.positioning.pose import Pose, PoseFilter, update
from vehicle_client.sensing.calibration import WHEELBASE_M

FloatArray = NDArray[np.float64]

CHI_SQUARE_95 = 5.991
"""95 % of the squared distances of a plane normal distribution, in standard deviations, lie below."""

ASKED_SHARE = (0.9, 0.98)
"""Of the moments whose ellipse holds the truth: fewer are too sure, more are too careful."""

HEADING_FROM_MPS = 5.0
"""Slower, a course says little; a place ahead is then near as well."""

AHEAD_M = 50.0
"""Where the smoothness of warnings is looked at."""


@dataclass(frozen=True, slots=True)
class PoseTrace:
    """A drive's poses at moments (N,) after the start: errors east and north (N, 2), their covariances (N, 2, 2), error
    and standard deviation of the heading (N,), the jump of a place ahead since the frame before (N,), all NaN without a
    pose; and errors of the fixes themselves with their times."""

    time_s: FloatArray
    error_m: FloatArray
    covariance_m2: FloatArray
    heading_error_rad: FloatArray
    heading_sd_rad: FloatArray
    jump_m: FloatArray
    speed_mps: FloatArray
    fix_time_s: FloatArray
    fix_error_m: FloatArray
    reasons: tuple[str | None, ...]


@dataclass(frozen=True, slots=True)
class PoseFigures:
    """Of one or several traces: shares are of the moments with a pose."""

    moments: int
    with_pose: float
    raw_median_m: float
    median_m: float
    p95_m: float
    coverage: float
    heading_rms_deg: float
    heading_within_2_sd: float
    jump_p99_m: float
    jump_max_m: float


def traced(drive: PoseDrive) -> PoseTrace:
    """Fold a drive's frames into poses, and hold each against the truth."""
    state, before = PoseFilter(delay_sd_s=drive.delay_sd_s), None
    tracker: Tracker = Wheels(WHEELBASE_M) if drive.frames[0].odom_from_vehicle is None else Given()
    rows = np.full((len(drive.frames), 8), math.nan)
    reasons: list[str | None] = []
    for k, frame in enumerate(drive.frames):
        state, found = update(state, replace(frame, odom_from_vehicle=tracker.odom_from_vehicle(frame)))
        reasons.append(found.reason)
        if found.pose is not None:
            rows[k] = _row(drive, k, found.pose, before)
        before = found.pose
    stamps = np.array([frame.stamp_s for frame in drive.frames])
    fix_time_s, fix_error_m = _fix_errors(drive, stamps)
    return PoseTrace(
        time_s=stamps - stamps[0],
        error_m=rows[:, :2],
        covariance_m2=np.stack([rows[:, [2, 4]], rows[:, [4, 3]]], axis=1),
        heading_error_rad=rows[:, 5],
        heading_sd_rad=rows[:, 6],
        jump_m=rows[:, 7],
        speed_mps=drive.speed_mps,
        fix_time_s=fix_time_s - stamps[0],
        fix_error_m=fix_error_m,
        reasons=tuple(reasons),
    )


def _row(drive: PoseDrive, number: int, pose: Pose, before: Pose | None) -> list[float]:
    error = drive.origin.enu(pose.position, pose.altitude_m)[:2] - drive.place_m[number]
    covariance = pose.covariance_m2
    turned = math.remainder(yaw_of(pose.enu_from_vehicle) - drive.yaw_rad[number], 2 * math.pi)
    return [
        *error,
        covariance[0, 0],
        covariance[1, 1],
        covariance[0, 1],
        turned,
        pose.heading_sd_rad,
        math.nan if before is None else jump_ahead_m(before, pose),
    ]


def jump_ahead_m(before: Pose, now: Pose) -> float:
    """By how much a place of the map ahead of the car moved in `odom` from one pose to the next: what a driver sees."""
    ahead = apply(now.enu_from_vehicle, np.array([AHEAD_M, 0.0, 0.0]))
    in_old_enu = ahead if before.origin == now.origin else before.origin.enu(*now.origin.geodetic(ahead))
    in_odom = [apply(inverse(pose.enu_from_odom), place) for pose, place in ((now, ahead), (before, in_old_enu))]
    return float(np.linalg.norm((in_odom[0] - in_odom[1])[:2]))


def _fix_errors(drive: PoseDrive, stamps_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Stamps (F,) of the fixes and their errors (F, 2), as they are stamped."""
    fixes = [(frame.stamp_s, frame.gnss) for frame in drive.frames if frame.gnss is not None]
    times = np.array([stamp if fix.stamp_s is None else fix.stamp_s for stamp, fix in fixes])
    places = np.array([drive.origin.enu(fix.position, fix.altitude_m)[:2] for _, fix in fixes]).reshape(-1, 2)
    truth = np.stack([np.interp(times, stamps_s, drive.place_m[:, axis]) for axis in range(2)], axis=1)
    return times, places - truth


def inside_ellipse(trace: PoseTrace) -> NDArray[np.bool_]:
    """Whether the 95 % ellipse holds the truth, for each moment with a pose (P,)."""
    known = np.isfinite(trace.error_m[:, 0])
    error, covariance = trace.error_m[known], trace.covariance_m2[known]
    squared = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0])
    return np.asarray(squared <= CHI_SQUARE_95)


def figures(traces: Sequence[PoseTrace]) -> PoseFigures:
    """What several drives show together."""
    error = np.concatenate([np.hypot(*t.error_m.T) for t in traces])
    known = np.isfinite(error)
    heading = np.concatenate([t.heading_error_rad for t in traces])
    sd = np.concatenate([t.heading_sd_rad for t in traces])
    fast = known & (np.concatenate([t.speed_mps for t in traces]) > HEADING_FROM_MPS)
    jumps = np.concatenate([t.jump_m for t in traces])
    jumps = jumps[np.isfinite(jumps)]
    return PoseFigures(
        moments=len(error),
        with_pose=float(known.mean()),
        raw_median_m=float(np.median(np.concatenate([np.hypot(*t.fix_error_m.T) for t in traces]))),
        median_m=float(np.median(error[known])),
        p95_m=float(np.percentile(error[known], 95)),
        coverage=float(np.concatenate([inside_ellipse(t) for t in traces]).mean()),
        heading_rms_deg=math.degrees(float(np.sqrt((heading[fast] ** 2).mean()))),
        heading_within_2_sd=float((np.abs(heading[known]) <= 2 * sd[known]).mean()),
        jump_p99_m=float(np.percentile(jumps, 99)),
        jump_max_m=float(jumps.max()),
    )


@dataclass(frozen=True, slots=True)
class DriveCounts:
    """How many drives have the truth in the ellipse always, above, within and below `ASKED_SHARE` of the moments."""

    always: int
    above: int
    within: int
    below: int


def counted(traces: Sequence[PoseTrace]) -> DriveCounts:
    """What several drives show one by one."""
    least, most = ASKED_SHARE
    shares = np.array([inside_ellipse(trace).mean() for trace in traces])
    return DriveCounts(
        always=int((shares == 1).sum()),
        above=int(((shares > most) & (shares < 1)).sum()),
        within=int(((shares >= least) & (shares <= most)).sum()),
        below=int((shares < least).sum()),
    )
