"""Which cars may take part: none drives through another one, or through a parked one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simulator.motion import Motion
from simulator.streets.street import ParkedCar

FloatArray = NDArray[np.float64]

DISCS_M, DISC_RADIUS_M = np.array([-1.45, 0.0, 1.45]), 0.95
"""A car of 4.3 by 1.8 m as three discs along it, with a hand's breadth around."""

STEP_S = 0.1
"""Two cars that cross at 50 km/h come nearer by less than a disc's radius and a half."""


class RoadSpace:
    """The room that cars take up over a time; parked ones keep theirs throughout."""

    def __init__(self, parked: Sequence[ParkedCar], duration_s: float) -> None:
        self._times = np.arange(0.0, duration_s + STEP_S, STEP_S)
        stood = np.array([(c.x_m, c.y_m, np.cos(c.yaw_rad), np.sin(c.yaw_rad)) for c in parked]).reshape(-1, 4)
        self._parked = _discs(stood[:, :2], stood[:, 2:]).reshape(-1, 2)
        self._taken: list[FloatArray] = []

    def take(self, motion: Motion) -> None:
        """A car drives, whoever is in its way."""
        self._taken.append(self._track(motion))

    def take_if_free(self, motion: Motion) -> bool:
        """Let a car drive if it touches no other one, and say whether it does."""
        track = self._track(motion)
        if any(_touch(track, other) for other in self._taken) or self._meets_parked(track):
            return False
        self._taken.append(track)
        return True

    def _track(self, motion: Motion) -> FloatArray:
        poses = motion.poses(self._times)
        return _discs(poses[:, :2, 3], poses[:, :2, 0])

    def _meets_parked(self, track: FloatArray) -> bool:
        points = track.reshape(-1, 2)
        low, high = points.min(axis=0) - 2 * DISC_RADIUS_M, points.max(axis=0) + 2 * DISC_RADIUS_M
        near = self._parked[((self._parked > low) & (self._parked < high)).all(axis=1)]
        return any(bool((np.hypot(*(points - one).T) < 2 * DISC_RADIUS_M).any()) for one in near)


def _discs(middle_m: FloatArray, forward: FloatArray) -> FloatArray:
    """Middles of the discs (N, 3, 2) of cars at (N, 2), looking along (N, 2)."""
    return np.asarray(middle_m[:, None] + DISCS_M[:, None] * forward[:, None])


def _touch(one: FloatArray, other: FloatArray) -> bool:
    near = np.hypot(*(one[:, 1] - other[:, 1]).T) < 2 * (DISCS_M[-1] + DISC_RADIUS_M)
    between = one[near][:, :, None] - other[near][:, None]
    return bool((np.hypot(between[..., 0], between[..., 1]) < 2 * DISC_RADIUS_M).any())
