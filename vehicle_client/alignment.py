"""How the server's map lies on what this car sees: one shift for all, since all places share the car's pose error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment

from contract.geometry import Sign
from contract.obstacle import ObstacleFeature
from vehicle_client.frames import Vector, apply, inverse
from vehicle_client.positioning.pose import Pose
from vehicle_client.tracking import Track

GATE_M = 5.0
"""A track and a mapped obstacle farther apart are not the same: 3.5 sigma of two satellite positions of 1 m."""

CONSISTENT_M = 1.0
"""Pairs of one shift agree within this: the error that the places of one drive do not share, 3 sigma."""

ALIGNED_SD_M = 0.35
"""Error of a mapped place after the shift, per axis: what neighbouring places do not share."""


@dataclass(frozen=True, slots=True)
class Alignment:
    """Shift (2,) in `odom` that lays the map on the tracks, and the standard deviation of a mapped place after it."""

    shift_m: Vector = field(default_factory=lambda: np.zeros(2))
    pairs: int = 0

    def place_sd_m(self, stored_sd_m: float, pose_sd_m: float) -> float:
        """Standard deviation per axis of a mapped place relative to the car."""
        unaligned = math.hypot(stored_sd_m, pose_sd_m)
        return min(ALIGNED_SD_M, unaligned) if self.pairs else unaligned


UNALIGNED = Alignment()
"""Nothing seen yet that the map could be laid on."""


def align(features: Sequence[ObstacleFeature], tracks: Sequence[Track], pose: Pose) -> Alignment:
    """The shift that most pairs of a believed track and a mapped obstacle of its sign agree on.

    None, when two different shifts have as many pairs: a wrong shift is worse than an unsure place.
    """
    seen = [t for t in tracks if t.confirmed]
    if not seen or not features:
        return UNALIGNED
    odom_from_enu = inverse(pose.enu_from_odom)
    places = np.array(
        [apply(odom_from_enu, pose.origin.enu(f.position, f.properties.altitude_m))[:2] for f in features]
    )
    offsets = np.array([t.centre_odom_m[:2] for t in seen])[:, None] - places[None]
    same_sign = np.array([[t.is_negative == (f.properties.sign is Sign.NEGATIVE) for f in features] for t in seen])
    possible = same_sign & (np.linalg.norm(offsets, axis=2) < GATE_M)
    candidates = [_agreeing(offsets, possible, shift) for shift in offsets[possible]]
    if not candidates:
        return UNALIGNED
    most = max(len(pairs) for pairs in candidates)
    shifts = np.array([pairs.mean(axis=0) for pairs in candidates if len(pairs) == most])
    if np.linalg.norm(shifts - shifts[0], axis=1).max() > CONSISTENT_M:
        return UNALIGNED
    return Alignment(shifts[0], most)


def _agreeing(offsets: Vector, possible: Vector, shift: Vector) -> Vector:
    """Offsets (P, 2) of the one-to-one pairs that agree with a shift."""
    distance = np.where(possible, np.linalg.norm(offsets - shift, axis=2), np.inf)
    cost = np.minimum(distance, CONSISTENT_M)
    rows, columns = linear_sum_assignment(cost)
    agree = distance[rows, columns] < CONSISTENT_M
    pairs: Vector = offsets[rows[agree], columns[agree]]
    return pairs
