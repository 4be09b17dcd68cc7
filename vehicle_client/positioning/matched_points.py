"""Which points of a sweep are laid on the map: few of the ground, no more of the rest than tell the way."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from vehicle_client.frames import Matrix, Vector

REACH_M = 100.0
"""What is farther is not matched: KISS-ICP's own default."""

GROUND_BELOW_M = 0.4
"""A ring on a flat road looks the same wherever the car is, and holds a match where it was: on a simulated street the
whole sweep moves by 1 m in 57, and what is higher than kerbs by 57.4."""

MOST_ABOVE, MOST_GROUND = 24_000, 1_200
"""Of a sweep of 115,000 points so many, evenly chosen, give the same way in half the time, and half of them a rougher
one; of the ground a few keep height, pitch and roll."""


def worth_matching(points_m: NDArray[np.float32], up: Vector) -> Matrix:
    """Points (M, 3) of a sweep (N, 3) that are to be matched: evenly chosen of what is above the ground, then of it.

    `up` (4,) is the row of vehicle_from_sensor that tells heights. What is not finite, or out of reach, is left out.
    """
    chosen = _chosen(np.ascontiguousarray(points_m, dtype=np.float32), up.astype(np.float32))
    return np.asarray(chosen, dtype=np.float64)


@numba.njit(cache=True, nogil=True)
def _chosen(points: NDArray[np.float32], up: NDArray[np.float32]) -> Matrix:
    above, below = np.empty(len(points), dtype=np.int64), np.empty(len(points), dtype=np.int64)
    highs, lows = 0, 0
    for i in range(len(points)):
        height = points[i, 0] * up[0] + points[i, 1] * up[1] + points[i, 2] * up[2] + up[3]
        # Of a point with any value that is not finite the height is not, either.
        if height <= GROUND_BELOW_M:
            below[lows] = i
            lows += 1
        elif math.isfinite(height):
            above[highs] = i
            highs += 1
    chosen = np.empty((MOST_ABOVE + MOST_GROUND, 3))
    number = _add_thinned(points, above[:highs], MOST_ABOVE, chosen, 0)
    return chosen[: _add_thinned(points, below[:lows], MOST_GROUND, chosen, number)]


@numba.njit(cache=True, nogil=True)
def _add_thinned(
    points: NDArray[np.float32], indices: NDArray[np.int64], most: int, chosen: Matrix, number: int
) -> int:
    """Writes each so many-th of the points at `indices` that is within reach behind `number` others; their number."""
    for k in range(0, len(indices), math.ceil(max(1, len(indices)) / most)):
        x, y, z = points[indices[k]]
        if x * x + y * y + z * z < REACH_M * REACH_M:
            chosen[number, 0], chosen[number, 1], chosen[number, 2] = x, y, z
            number += 1
    return number
