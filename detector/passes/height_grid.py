"""The road as a bird's-eye grid over several sweeps: what one sweep touches once or twice adds up to a shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from detector.arrays import Float32Array, FloatArray, IntArray
from detector.road.corridor import AHEAD_M, BEHIND_M, Corridor
from detector.road.deviations import Deviations
from detector.road.ground import road_coordinates
from detector.road.robust import MAD_TO_SD

CELL_M = 0.1
# Rings beyond this lie metres apart, and what a sweep says of the road there is mostly its own hits.
MAX_RANGE_M = 40.0
# Cells are smoothed over a fifth of the smallest hole.
SIGMA_M = 0.06
# Less than what one hit is worth in the cell beside it says nothing about a cell.
MIN_WEIGHT = 0.03
# Cells of equal certainty: smoothed hits up to these.
WEIGHT_CLASSES = np.array([0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0])
# Texture of asphalt within a cell, and what the pose leaves between sweeps.
NOISE_FLOOR_M = 0.002
MIN_CLASS_CELLS = 50
NOISE_BAND_M = 0.1


@dataclass(frozen=True, slots=True)
class GridFrame:
    """Cells (K,) of one sweep's strip of road: middle of the cell and mean height of its hits in `odom` (K, 3), hits,
    and their summed residual to that sweep's own surface, which takes out its errors of pitch, roll and height."""

    centre_odom_m: FloatArray
    hits: FloatArray
    total_m: FloatArray


def grid_frame(points_m: Float32Array, residual_m: Float32Array, odom_from_sensor: FloatArray) -> GridFrame:
    """Cells of a sweep: points (N, 3) in `sensor`, residuals (N,) with NaN off the strip, pose (4, 4)."""
    hit, residual = _strip_hits(points_m, residual_m, np.ascontiguousarray(odom_from_sensor))
    if len(hit) == 0:
        return GridFrame(np.empty((0, 3)), np.empty(0), np.empty(0))
    cell = np.floor(hit[:, :2] / CELL_M).astype(np.int64)
    first = cell.min(axis=0)
    width = int(cell[:, 0].max() - first[0]) + 1
    height = int(cell[:, 1].max() - first[1]) + 1
    index = (cell[:, 1] - first[1]) * width + cell[:, 0] - first[0]
    found, hits, total, z = _sums(index, residual, hit[:, 2], width * height)
    centre = np.stack([found % width + first[0], found // width + first[1]], axis=1) + 0.5
    return GridFrame(np.concatenate([centre * CELL_M, (z / hits)[:, None]], axis=1), hits, total)


@njit(cache=True, nogil=True)
def _strip_hits(
    points: Float32Array, residual: Float32Array, odom_from_sensor: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Points in `odom` (K, 3) and residuals (K,) of what lies on the strip and not too far."""
    hit, kept, number = np.empty((len(points), 3)), np.empty(len(points)), 0
    for i in range(len(points)):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        if np.isfinite(residual[i]) and x * x + y * y < MAX_RANGE_M * MAX_RANGE_M:
            for k in range(3):
                turned = odom_from_sensor[k, 0] * x + odom_from_sensor[k, 1] * y + odom_from_sensor[k, 2] * z
                hit[number, k] = turned + odom_from_sensor[k, 3]
            kept[number] = residual[i]
            number += 1
    return hit[:number], kept[:number]


@njit(cache=True, nogil=True)
def _sums(
    index: IntArray, residual: FloatArray, height: FloatArray, cells: int
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Cells that were hit, in the order of the grid, with their hits, summed residuals and summed heights."""
    hits, total, z = np.zeros(cells), np.zeros(cells), np.zeros(cells)
    for i in range(len(index)):
        hits[index[i]] += 1.0
        total[index[i]] += residual[i]
        z[index[i]] += height[i]
    found = np.flatnonzero(hits)
    return found, hits[found], total[found], z[found]


def deviations_over(
    frames: tuple[GridFrame, ...], sensor_from_odom: FloatArray, corridor: Corridor, sensor_height_m: float
) -> Deviations:
    """Deviations of the smoothed cells of several sweeps, along and across the corridor of the latest."""
    centres = np.concatenate([frame.centre_odom_m for frame in frames])
    xy = _seen_from(centres, np.ascontiguousarray(sensor_from_odom))
    along, across = road_coordinates(xy, corridor.curvature_per_m)
    hits, total = (np.concatenate([getattr(frame, name) for frame in frames]) for name in ("hits", "total_m"))
    shape = (int((AHEAD_M + BEHIND_M) / CELL_M), int((corridor.left_m - corridor.right_m) / CELL_M) + 1)
    weight, mean = _smoothed(along, across - corridor.offset_m(along), hits, total, corridor.right_m, shape, _kernel())
    row, column = np.nonzero(weight > MIN_WEIGHT)
    along = np.asarray((row + 0.5) * CELL_M - BEHIND_M, dtype=np.float64)
    across = np.asarray((column + 0.5) * CELL_M + corridor.right_m, dtype=np.float64)
    residual = mean[row, column]
    noise = _noise(residual, weight[row, column])
    return Deviations(along, across, np.hypot(along, across), residual, noise, sensor_height_m)


@njit(cache=True, nogil=True)
def _seen_from(points: FloatArray, sensor_from_odom: FloatArray) -> FloatArray:
    """Points (N, 3) of `odom` in the plane of the frame `sensor`, (N, 2)."""
    xy = np.empty((len(points), 2))
    for i in range(len(points)):
        for k in range(2):
            turned = sensor_from_odom[k, 0] * points[i, 0] + sensor_from_odom[k, 1] * points[i, 1]
            xy[i, k] = turned + sensor_from_odom[k, 2] * points[i, 2] + sensor_from_odom[k, 3]
    return xy


def _kernel() -> FloatArray:
    reach = int(np.ceil(2.5 * SIGMA_M / CELL_M))
    steps = np.arange(-reach, reach + 1, dtype=np.float64) * CELL_M / SIGMA_M
    kernel = np.exp(-0.5 * np.square(steps))
    return np.asarray(kernel / kernel.sum(), dtype=np.float64)


@njit(cache=True, nogil=True)
def _smoothed(
    along: FloatArray,
    across: FloatArray,
    hits: FloatArray,
    total: FloatArray,
    right: float,
    shape: tuple[int, int],
    kernel: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Smoothed hits and mean residual of each cell of the strip."""
    rows, columns = shape
    weight, summed = np.zeros((rows, columns)), np.zeros((rows, columns))
    for i in range(len(along)):
        row, column = int(np.floor((along[i] + BEHIND_M) / CELL_M)), int(np.floor((across[i] - right) / CELL_M))
        if 0 <= row < rows and 0 <= column < columns:
            weight[row, column] += hits[i]
            summed[row, column] += total[i]
    reach = len(kernel) // 2
    w, v = np.zeros((rows, columns)), np.zeros((rows, columns))
    for row in range(rows):
        for column in range(columns):
            if weight[row, column] > 0.0:
                for j in range(max(-reach, -column), min(reach + 1, columns - column)):
                    w[row, column + j] += kernel[j + reach] * weight[row, column]
                    v[row, column + j] += kernel[j + reach] * summed[row, column]
    weight[:], summed[:] = 0.0, 0.0
    for row in range(rows):
        for i in range(max(-reach, -row), min(reach + 1, rows - row)):
            for column in range(columns):
                weight[row, column] += kernel[i + reach] * w[row + i, column]
                summed[row, column] += kernel[i + reach] * v[row + i, column]
    for row in range(rows):
        for column in range(columns):
            if weight[row, column] > 0.0:
                summed[row, column] /= weight[row, column]
    return weight, summed


@njit(cache=True, nogil=True)
def _noise(residual: FloatArray, weight: FloatArray) -> FloatArray:
    """Standard deviation (K,) of the cells' means, measured among those of equal certainty."""
    kind = np.searchsorted(WEIGHT_CLASSES, weight, side="right") - 1
    of_kind, flat = np.empty(len(WEIGHT_CLASSES)), np.empty(len(residual))
    known = NOISE_BAND_M / 3.0
    for k in range(len(WEIGHT_CLASSES)):
        number = 0
        for i in range(len(residual)):
            if kind[i] == k and abs(residual[i]) < NOISE_BAND_M:
                flat[number] = abs(residual[i])
                number += 1
        if number >= MIN_CLASS_CELLS:
            known = max(MAD_TO_SD * np.median(flat[:number]), NOISE_FLOOR_M)
        of_kind[k] = known
    return of_kind[kind]
