"""The road as a bird's-eye grid over several sweeps: what one sweep touches once or twice adds up to a shape."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from detector.arrays import Float32Array, FloatArray
from detector.road.corridor import AHEAD_M, BEHIND_M, PATH_SCALE_M, Corridor
from detector.road.deviations import Deviations
from detector.road.ground import road_coordinate
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
    return GridFrame(*_grid_frame(points_m, residual_m, np.ascontiguousarray(odom_from_sensor)))


@njit(cache=True, nogil=True)
def _grid_frame(
    points: Float32Array, residual: Float32Array, odom_from_sensor: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Middles (K, 3), hits (K,) and summed residuals (K,) of the cells that were hit, by rows of the grid."""
    hit, kept = _strip_hits(points, residual, odom_from_sensor)
    if len(hit) == 0:
        return np.empty((0, 3)), np.empty(0), np.empty(0)
    column, row = np.empty(len(hit), dtype=np.int64), np.empty(len(hit), dtype=np.int64)
    for i in range(len(hit)):
        column[i], row[i] = math.floor(hit[i, 0] / CELL_M), math.floor(hit[i, 1] / CELL_M)
    left, first, width = column.min(), row.min(), column.max() - column.min() + 1
    # First which cells there are: sums over the whole grid would be five times as much memory as what is hit.
    number = np.zeros(((row.max() - first + 1) * width), dtype=np.int32)
    for i in range(len(hit)):
        number[(row[i] - first) * width + column[i] - left] = 1
    cells = 0
    for k in range(len(number)):
        if number[k] > 0:
            cells += 1
            number[k] = cells
    centre, hits, total = np.zeros((cells, 3)), np.zeros(cells), np.zeros(cells)
    for i in range(len(hit)):
        cell = number[(row[i] - first) * width + column[i] - left] - 1
        centre[cell, 0], centre[cell, 1] = (column[i] + 0.5) * CELL_M, (row[i] + 0.5) * CELL_M
        centre[cell, 2] += hit[i, 2]
        hits[cell] += 1.0
        total[cell] += kept[i]
    for cell in range(cells):
        centre[cell, 2] /= hits[cell]
    return centre, hits, total


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


def deviations_over(
    frames: tuple[GridFrame, ...], sensor_from_odom: FloatArray, corridor: Corridor, sensor_height_m: float
) -> Deviations:
    """Deviations of the smoothed cells of several sweeps, along and across the corridor of the latest."""
    shape = (int((AHEAD_M + BEHIND_M) / CELL_M), int((corridor.left_m - corridor.right_m) / CELL_M) + 1)
    weight, summed = np.zeros(shape), np.zeros(shape)
    path = (corridor.curvature_per_m, *corridor.path_m, corridor.right_m)
    for frame in frames:
        seen_from = np.ascontiguousarray(sensor_from_odom)
        _add_cells(frame.centre_odom_m, frame.hits, frame.total_m, seen_from, path, weight, summed)
    _smooth(weight, summed, _kernel())
    along, across, residual, certainty = _certain(weight, summed, corridor.right_m)
    range_m, noise = np.hypot(along, across), _noise(residual, certainty)
    return Deviations(along, across, range_m, residual, noise, sensor_height_m, cell_m=CELL_M)


@njit(cache=True, nogil=True)
def _add_cells(
    centres: FloatArray,
    hits: FloatArray,
    total: FloatArray,
    sensor_from_odom: FloatArray,
    path: tuple[float, float, float, float, float],
    weight: FloatArray,
    summed: FloatArray,
) -> None:
    """Adds the cells (K,) of one sweep, in `odom`, to hits and residuals of the grid along the path of the corridor:
    its curvature, the three terms of its offset, and where its right edge is."""
    curvature, heading, bend, change, right = path
    rows, columns = weight.shape
    for i in range(len(centres)):
        x, y = _seen(centres[i], sensor_from_odom[0]), _seen(centres[i], sensor_from_odom[1])
        along, across = road_coordinate(x, y, curvature)
        part = along / PATH_SCALE_M
        across = across - part * (heading + part * (bend + part * change))
        row, column = math.floor((along + BEHIND_M) / CELL_M), math.floor((across - right) / CELL_M)
        if 0 <= row < rows and 0 <= column < columns:
            weight[row, column] += hits[i]
            summed[row, column] += total[i]


@njit(cache=True, nogil=True)
def _seen(point: FloatArray, axis: FloatArray) -> float:
    """A point (3,) of `odom` along one axis of the frame `sensor`, a row (4,) of sensor_from_odom."""
    turned = axis[0] * point[0] + axis[1] * point[1]
    return float(turned + axis[2] * point[2] + axis[3])


@njit(cache=True, nogil=True)
def _certain(
    weight: FloatArray, mean: FloatArray, right: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Places along and across, mean residual and smoothed hits (K,) of the cells that hits say enough about."""
    rows, columns = weight.shape
    number = 0
    for row in range(rows):
        for column in range(columns):
            number += weight[row, column] > MIN_WEIGHT
    along, across, residual, hits = np.empty(number), np.empty(number), np.empty(number), np.empty(number)
    number = 0
    for row in range(rows):
        for column in range(columns):
            if weight[row, column] > MIN_WEIGHT:
                along[number], across[number] = (row + 0.5) * CELL_M - BEHIND_M, (column + 0.5) * CELL_M + right
                residual[number], hits[number] = mean[row, column], weight[row, column]
                number += 1
    return along, across, residual, hits


def _kernel() -> FloatArray:
    reach = int(np.ceil(2.5 * SIGMA_M / CELL_M))
    steps = np.arange(-reach, reach + 1, dtype=np.float64) * CELL_M / SIGMA_M
    kernel = np.exp(-0.5 * np.square(steps))
    return np.asarray(kernel / kernel.sum(), dtype=np.float64)


@njit(cache=True, nogil=True)
def _smooth(weight: FloatArray, summed: FloatArray, kernel: FloatArray) -> None:
    """Smooths the hits of each cell of the strip, and makes of the summed residuals smoothed means."""
    rows, columns = weight.shape
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


@njit(cache=True, nogil=True)
def _noise(residual: FloatArray, weight: FloatArray) -> FloatArray:
    """Standard deviation (K,) of the cells' means, measured among those of equal certainty."""
    classes = len(WEIGHT_CLASSES)
    kind = np.searchsorted(WEIGHT_CLASSES, weight, side="right") - 1
    number, flat = np.zeros(classes, dtype=np.int64), np.empty((classes, len(residual)))
    for i in range(len(residual)):
        if abs(residual[i]) < NOISE_BAND_M:
            flat[kind[i], number[kind[i]]] = abs(residual[i])
            number[kind[i]] += 1
    of_kind, known = np.empty(classes), NOISE_BAND_M / 3.0
    for k in range(classes):
        if number[k] >= MIN_CLASS_CELLS:
            known = max(MAD_TO_SD * np.median(flat[k, : number[k]]), NOISE_FLOOR_M)
        of_kind[k] = known
    return of_kind[kind]
