"""The one value that every source yields, whatever it reads."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contract.geometry import LatLon


class SourceError(ValueError):
    """A file or stream cannot be read; the message says what was expected."""


OF_VEHICLE = (0.0, 0.0, 0.0)
"""`GnssFix.antenna_m` of a fix that its source has moved to the vehicle frame's origin."""


@dataclass(frozen=True, slots=True)
class GnssFix:
    """A satellite fix of a place on the car (`antenna_m`); `sd_m` is the horizontal standard deviation of each axis."""

    position: LatLon
    altitude_m: float
    heading_rad: float | None
    """Clockwise from north, from a dual antenna or an inertial unit; None where nothing of the kind is on board."""
    sd_m: float
    altitude_sd_m: float
    course_rad: float | None = None
    """Direction of the velocity over ground, clockwise from north, as receivers say it."""
    speed_mps: float | None = None
    """Speed over ground by the receiver."""
    stamp_s: float | None = None
    """Unix time of the measurement; None: that of the frame that brings it."""
    antenna_m: tuple[float, float, float] | None = None
    """The place that it is of, in the `vehicle` frame, where the source knows it or has moved the fix to the origin;
    None: the antenna of the calibration."""


@dataclass(frozen=True, slots=True)
class Motion:
    """What wheels or an inertial unit said at a moment, Unix time; yaw rate counter-clockwise about the car's z."""

    stamp_s: float
    speed_mps: float | None = None
    yaw_rate_rps: float | None = None


@dataclass(frozen=True, slots=True)
class LidarFrame:
    """One sweep: `points_m` (N, 3) float32 metres in the `sensor` frame (REP 103: x forward, y left, z up).

    `stamp_s` is Unix time. Optional: `intensity` and `ring` (N,), `point_time_s` (N,) seconds after `stamp_s` (mostly
    negative) at which each point was measured, `image` (H, W, 3) uint8 BGR of the forward camera and its own stamp,
    `odom_from_vehicle` (4, 4) from odometry at `stamp_s`, the last fix `gnss`, those before it (`earlier_fixes`) and
    `motions` since the frame before, in the order of time, `steering_rad` of the front wheels (positive left),
    `speed_mps`.
    """

    stamp_s: float
    points_m: NDArray[np.float32]
    intensity: NDArray[np.float32] | None = None
    ring: NDArray[np.uint16] | None = None
    image: NDArray[np.uint8] | None = None
    odom_from_vehicle: NDArray[np.float64] | None = None
    gnss: GnssFix | None = None
    steering_rad: float = 0.0
    speed_mps: float | None = None
    point_time_s: NDArray[np.float32] | None = None
    image_stamp_s: float | None = None
    motions: tuple[Motion, ...] = ()
    earlier_fixes: tuple[GnssFix, ...] = ()

    @property
    def fixes(self) -> tuple[GnssFix, ...]:
        """All fixes that it brings, in the order of time."""
        return self.earlier_fixes if self.gnss is None else (*self.earlier_fixes, self.gnss)


MOST_INHERITED = 1_000
"""Fixes, and motions: ten seconds of an inertial unit at 100 Hz. Odometry begins anew after less without a sweep."""


def inheriting(frame: LidarFrame, dropped: LidarFrame) -> LidarFrame:
    """The frame with the fixes and motions of one before it that is dropped: they are of the car, not of its sweep."""
    fixes = (*(_stamped(fix, dropped.stamp_s) for fix in dropped.fixes), *frame.fixes)[-MOST_INHERITED:]
    return replace(
        frame,
        gnss=fixes[-1] if fixes else None,
        earlier_fixes=fixes[:-1],
        motions=(*dropped.motions, *frame.motions)[-MOST_INHERITED:],
    )


def _stamped(fix: GnssFix, frame_s: float) -> GnssFix:
    return fix if fix.stamp_s is not None and math.isfinite(fix.stamp_s) else replace(fix, stamp_s=frame_s)


class Source(Protocol):
    """A drive: its number of sweeps, and the sweeps in the order of time."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[LidarFrame]: ...
