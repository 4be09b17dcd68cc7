"""How far points of the road ahead lie off its surface, and which of them by more than noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit

from detector.arrays import FloatArray, IntArray
from detector.road.ground import AHEAD_M, REACH_M

# Deviation that flags a point, but not the texture of asphalt and patches; what is noise is told by the cluster.
FLAG_SD = 2.5
MIN_DEPTH_M = 0.02
MIN_HEIGHT_M = 0.025
# Deeper is no pothole but a reflection below the road; higher is an overhang.
MAX_DEPTH_M = 0.5
OVERHANG_M = 2.5
# Points of a sweep in one cell, or in two that touch, are neighbours.
SWEEP_CELL_M = 0.25
# Beyond this range rings lie farther apart than a cell: cells grow with range so that neighbours stay neighbours.
COMPRESS_FROM_M = 12.0
# Behind this the car sees nothing that it did not see nearer before.
BEHIND_M = 12.0
ROW_M = 1.0


@dataclass(frozen=True, slots=True)
class Cells:
    """Cell (N,) of each point in a grid of a shape, -1 of none, and the number of points in each cell."""

    cell: IntArray
    hits: IntArray
    shape: tuple[int, int]


@dataclass(frozen=True, slots=True)
class ByMetre:
    """Order (N,) of points by metre of the road, where each metre begins in it, and the first metre."""

    order: IntArray
    start: IntArray
    first: int


@dataclass(frozen=True)
class Deviations:
    """Points of the corridor: coordinates along and across its path, signed residual to the surface and its noise,
    each (N,), in metres, and the sensor's height over the road; `cell_m` is how far apart neighbours are.

    What both signs of deviations share is worked out once.
    """

    along_m: FloatArray
    across_m: FloatArray
    range_m: FloatArray
    residual_m: FloatArray
    noise_m: FloatArray
    sensor_height_m: float
    cell_m: float = SWEEP_CELL_M

    @cached_property
    def cells(self) -> Cells:
        """The points by cell; cells grow with range, so that the grid is never larger than that of the strip."""
        shape = (int((BEHIND_M + AHEAD_M) / self.cell_m) + 4, int(2.0 * REACH_M / self.cell_m) + 4)
        cell, hits = _cells(self.along_m, self.across_m, self.range_m, self.cell_m, shape)
        return Cells(cell, hits, shape)

    @cached_property
    def by_metre(self) -> ByMetre:
        """The points by metre of the road."""
        return ByMetre(*_by_metre(self.along_m))

    @cached_property
    def level_range_m(self) -> FloatArray:
        """Range (N,) at which each point's ray crosses the road's level: one value a ring, in a hole or beside it."""
        return np.asarray(_level_range(self.range_m, self.residual_m, self.sensor_height_m))

    @property
    def below(self) -> np.ndarray:
        """Mask of points below the road by more than noise."""
        return np.asarray(_beyond_noise(self.residual_m, self.noise_m, -1.0, MIN_DEPTH_M, MAX_DEPTH_M))

    @property
    def above(self) -> np.ndarray:
        """Mask of points above the road by more than noise."""
        return np.asarray(_beyond_noise(self.residual_m, self.noise_m, 1.0, MIN_HEIGHT_M, OVERHANG_M))


@njit(cache=True, nogil=True)
def _level_range(range_m: FloatArray, residual: FloatArray, sensor_height: float) -> FloatArray:
    level = np.empty(len(range_m))
    for i in range(len(range_m)):
        level[i] = range_m[i] * sensor_height / max(sensor_height - residual[i], MIN_HEIGHT_M)
    return level


@njit(cache=True, nogil=True)
def _beyond_noise(residual: FloatArray, noise: FloatArray, sign: float, least: float, most: float) -> np.ndarray:
    """Mask (N,) of residuals of a sign that are greater than noise and than `least`, but less than `most`."""
    beyond = np.empty(len(residual), dtype=np.bool_)
    for i in range(len(residual)):
        beyond[i] = max(FLAG_SD * noise[i], least) < sign * residual[i] < most
    return beyond


@njit(cache=True, nogil=True)
def _cells(
    along: FloatArray, across: FloatArray, range_m: FloatArray, cell_m: float, shape: tuple[int, int]
) -> tuple[IntArray, IntArray]:
    """Cell (N,) of each point, and the number of points in each cell."""
    cell = np.full(len(along), -1, dtype=np.int64)
    hits = np.zeros(shape[0] * shape[1], dtype=np.int64)
    for i in range(len(along)):
        if along[i] <= -BEHIND_M:
            continue
        ratio = max(range_m[i] / COMPRESS_FROM_M, 1.0)
        scale = (1.0 + math.log(ratio)) / ratio / cell_m if ratio > 1.0 else 1.0 / cell_m
        row = int(along[i] * scale + BEHIND_M / cell_m) + 1
        column = int(across[i] * scale + REACH_M / cell_m) + 1
        if 0 < row < shape[0] - 1 and 0 < column < shape[1] - 1:
            cell[i] = row * shape[1] + column
            hits[cell[i]] += 1
    return cell, hits


@njit(cache=True, nogil=True)
def _by_metre(along: FloatArray) -> tuple[IntArray, IntArray, int]:
    if len(along) == 0:
        return np.empty(0, dtype=np.int64), np.zeros(1, dtype=np.int64), 0
    first, last = int(np.floor(along.min() / ROW_M)), int(np.floor(along.max() / ROW_M))
    starts = np.zeros(last - first + 2, dtype=np.int64)
    for i in range(len(along)):
        starts[int(np.floor(along[i] / ROW_M)) - first + 1] += 1
    starts = np.cumsum(starts)
    filled, order = starts.copy(), np.empty(len(along), dtype=np.int64)
    for i in range(len(along)):
        row = int(np.floor(along[i] / ROW_M)) - first
        order[filled[row]] = i
        filled[row] += 1
    return order, starts, first
