"""Maps of a pass on the cells of a grid, one for each group of sweeps, so that any group can be left out."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from detector.arrays import FloatArray, IntArray
from detector.passes.height_map import CELL_M, SIGMA_M, Grid, Map, mean_map

# A deep hit proves air only up to where its ray entered the hole; longer than this, the ray is too flat to be trusted.
MAX_AIR_M = 0.8
AIR_STEP_M = 0.02
KERNEL_REACH_SDS = 3.5
# Sparse passes are smoothed over so much of the hits' mean spacing.
SPACING_SIGMAS = 0.4

GroupMaps = FloatArray
"""(K, G, G): a map of each of K groups of sweeps."""


@dataclass(frozen=True, slots=True)
class Samples:
    """Hits relative to the window's centre: xy (N, 2), depth or height (N,), direction from hit to sensor (N, 2) with
    the tangent of the ray's angle to the road (N,), and the group (N,) of sweeps, of `groups`, of each."""

    xy_m: FloatArray
    relief_m: FloatArray
    to_sensor: FloatArray
    tangent: FloatArray
    group: IntArray
    groups: int


def without(maps: GroupMaps, group: int | None) -> FloatArray:
    """Sum (G, G) of the maps of all groups, or of all but one."""
    total = maps.sum(axis=0)
    return np.asarray(total if group is None else total - maps[group])


def relief_maps(samples: Samples, grid: Grid) -> tuple[GroupMaps, GroupMaps]:
    """Number of hits and sum of their relief in every cell."""
    maps: tuple[GroupMaps, GroupMaps] = _scatter(
        samples.xy_m, samples.relief_m, samples.group, samples.groups, grid.cells, grid.half_size_m
    )
    return maps


def smoothing_m(hits: int, grid: Grid) -> float:
    """Standard deviation of the smoothing for so many hits in the window."""
    return max(SIGMA_M, SPACING_SIGMAS * 2.0 * grid.half_size_m / math.sqrt(max(hits, 1)))


def relief_map(xy_m: FloatArray, relief_m: FloatArray, grid: Grid) -> Map:
    """Smoothed depth or height (G, G) of hits (N, 2); 0, the road, where none is near.

    Cells weigh alike however often they were hit: a wall that faces the sensor collects more hits than the floor.
    """
    sigma_m = smoothing_m(len(relief_m), grid)
    one = np.zeros(len(relief_m), dtype=np.int64)
    count, total = _scatter(xy_m, relief_m, one, 1, grid.cells, grid.half_size_m)
    mean = total / np.maximum(count, 1.0)
    near, deep = smooth(np.concatenate([(count > 0.0).astype(np.float64), mean]), sigma_m)
    return mean_map(grid, near, deep, sigma_m)


def evidence_maps(samples: Samples, grid: Grid, level_m: float, below: np.ndarray) -> tuple[GroupMaps, GroupMaps]:
    """Solid and free samples below the road in every cell.

    A hit `below` `level_m` (N,) proves air from where its ray crossed that level to the hit; the others are solid.
    """
    maps: tuple[GroupMaps, GroupMaps] = _trace(
        samples.xy_m,
        samples.relief_m,
        below,
        samples.to_sensor,
        samples.tangent,
        samples.group,
        samples.groups,
        level_m,
        grid.cells,
        grid.half_size_m,
    )
    return maps


def smooth(maps: GroupMaps, sigma_m: float) -> GroupMaps:
    """Each map (K, G, G) convolved with a Gaussian of sum 1."""
    reach = math.ceil(KERNEL_REACH_SDS * sigma_m / CELL_M)
    kernel = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) * CELL_M / sigma_m))
    return np.asarray(_convolve(np.ascontiguousarray(maps), kernel / kernel.sum()))


@njit(cache=True, nogil=True)
def _scatter(
    xy_m: FloatArray, values: FloatArray, group: IntArray, groups: int, cells: int, half_size_m: float
) -> tuple[FloatArray, FloatArray]:
    count, total = np.zeros((groups, cells, cells)), np.zeros((groups, cells, cells))
    for i in range(values.size):
        row = math.floor((xy_m[i, 0] + half_size_m) / CELL_M)
        column = math.floor((xy_m[i, 1] + half_size_m) / CELL_M)
        if 0 <= row < cells and 0 <= column < cells:
            count[group[i], row, column] += 1.0
            total[group[i], row, column] += values[i]
    return count, total


@njit(cache=True, nogil=True)
def _trace(
    xy_m: FloatArray,
    relief_m: FloatArray,
    below: np.ndarray,
    to_sensor: FloatArray,
    tangent: FloatArray,
    group: IntArray,
    groups: int,
    level_m: float,
    cells: int,
    half_size_m: float,
) -> tuple[FloatArray, FloatArray]:
    solid, free = np.zeros((groups, cells, cells)), np.zeros((groups, cells, cells))
    for i in range(relief_m.size):
        air_m = min((relief_m[i] - level_m) / tangent[i], MAX_AIR_M) if below[i] else 0.0
        steps, target = int(air_m / AIR_STEP_M) + 1, free if below[i] else solid
        for step in range(steps):
            row = math.floor((xy_m[i, 0] + step * AIR_STEP_M * to_sensor[i, 0] + half_size_m) / CELL_M)
            column = math.floor((xy_m[i, 1] + step * AIR_STEP_M * to_sensor[i, 1] + half_size_m) / CELL_M)
            if 0 <= row < cells and 0 <= column < cells:
                target[group[i], row, column] += 1.0
    return solid, free


@njit(cache=True, nogil=True)
def _convolve(maps: FloatArray, kernel: FloatArray) -> FloatArray:
    count, rows, columns = maps.shape
    reach = kernel.size // 2
    along, smoothed = np.zeros_like(maps), np.zeros_like(maps)
    for k in range(count):
        for row in range(rows):
            for column in range(columns):
                value = maps[k, row, column]
                if value != 0.0:
                    for step in range(max(-reach, -column), min(reach, columns - 1 - column) + 1):
                        along[k, row, column + step] += value * kernel[step + reach]
        for row in range(rows):
            for step in range(max(-reach, -row), min(reach, rows - 1 - row) + 1):
                weight = kernel[step + reach]
                for column in range(columns):
                    smoothed[k, row + step, column] += weight * along[k, row, column]
    return smoothed
