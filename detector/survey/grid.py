"""A raster over a survey: its spacing, means of cells, maps smoothed only by what was measured."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, label

from detector.arrays import FloatArray, IntArray

# Points of a coarse cell from whose median number the spacing is measured: their counts scatter by a quarter.
SPACING_POINTS = 16.0
SPACING_ITERATIONS = 4
# The raster never has more cells than this for each point, however far a few points lie.
MAX_CELLS_PER_POINT = 16.0
MIN_CELLS = 64


@dataclass(frozen=True, slots=True)
class Grid:
    """Square cells of `cell_m` over (x, y): the corner `origin_m` (2,) and the number of rows (y) and columns (x)."""

    origin_m: FloatArray
    cell_m: float
    shape: tuple[int, int]

    def cells(self, xy_m: FloatArray) -> IntArray:
        """Flat cell (N,) of each place (N, 2)."""
        column, row = (
            np.clip(((xy_m[:, k] - self.origin_m[k]) / self.cell_m).astype(np.int64), 0, self.shape[1 - k] - 1)
            for k in (0, 1)
        )
        return np.asarray(row * self.shape[1] + column)

    def count(self, cells: IntArray) -> FloatArray:
        """Number of points in each cell, (R, C)."""
        return np.bincount(cells, minlength=self.shape[0] * self.shape[1]).astype(np.float64).reshape(self.shape)

    def mean(self, cells: IntArray, values: FloatArray, count: FloatArray) -> FloatArray:
        """Mean value of each cell (R, C), 0 where it is empty."""
        total = np.bincount(cells, weights=values, minlength=count.size).reshape(self.shape)
        return np.asarray(total / np.maximum(count, 1.0))

    def sample(self, values: FloatArray, xy_m: FloatArray) -> FloatArray:
        """Values (N,) of a map (R, C) at places (N, 2), bilinear between the cells' centres."""
        return np.asarray(_bilinear(values, xy_m, self.origin_m, self.cell_m))


@njit(cache=True, nogil=True)
def _bilinear(values: FloatArray, xy: FloatArray, origin: FloatArray, cell: float) -> FloatArray:
    rows, columns = values.shape
    out = np.empty(len(xy))
    for n in range(len(xy)):
        x = min(max((xy[n, 0] - origin[0]) / cell - 0.5, 0.0), columns - 1.0)
        y = min(max((xy[n, 1] - origin[1]) / cell - 0.5, 0.0), rows - 1.0)
        j, i = int(x), int(y)
        right, below = min(j + 1, columns - 1), min(i + 1, rows - 1)
        u, v = x - j, y - i
        upper = values[i, j] * (1.0 - u) + values[i, right] * u
        lower = values[below, j] * (1.0 - u) + values[below, right] * u
        out[n] = upper * (1.0 - v) + lower * v
    return out


def measure_spacing(xy_m: FloatArray) -> float:
    """Distance in metres between neighbours of points (N, 2): the root of the area of one, where they are usual.

    From the median number of points in coarse cells, so neither gaps nor crowded walls count; 0 where all coincide.
    Points that coincide count once: two copies of a scan are no denser than one.
    """
    xy_m = _distinct(xy_m)
    low, high = xy_m.min(axis=0), xy_m.max(axis=0)
    span = np.maximum(high - low, 1e-9 * max(float((high - low).max()), 1e-300))
    spacing = math.sqrt(float(span[0] * span[1]) / len(xy_m))
    for _ in range(SPACING_ITERATIONS):
        if spacing <= 0.0:
            return 0.0
        cell = max(spacing * math.sqrt(SPACING_POINTS), float(span.max()) / 1e6)
        # Odd multiples of a pitch that divides a cell would alias; the median over all cells does not mind.
        index = np.floor((xy_m - low) / cell).astype(np.int64)
        counts = np.unique(index[:, 1] * (int(index[:, 0].max()) + 1) + index[:, 0], return_counts=True)[1]
        usual = float(np.median(np.repeat(counts, counts)))
        spacing = cell / math.sqrt(usual)
    return spacing


def _distinct(xy_m: FloatArray) -> FloatArray:
    """Places (M, 2), each once."""
    order = np.lexsort((xy_m[:, 1], xy_m[:, 0]))
    ordered = xy_m[order]
    return np.asarray(ordered[np.append(True, (np.diff(ordered, axis=0) != 0.0).any(axis=1))])


def make_grid(xy_m: FloatArray, cell_m: float) -> Grid:
    """Grid of the cell's size over all places (N, 2), coarser where a few lie so far that it would not fit memory."""
    low, high = xy_m.min(axis=0), xy_m.max(axis=0)
    span = np.maximum(high - low, cell_m)
    limit = max(MAX_CELLS_PER_POINT * len(xy_m), MIN_CELLS)
    cell = max(cell_m, math.sqrt(float(span[0] * span[1]) / limit))
    columns, rows = (int(span[k] / cell) + 1 for k in (0, 1))
    return Grid(low, cell, (rows, columns))


def components_of(mask: NDArray[np.bool_], *, diagonal: bool = False) -> tuple[IntArray, int]:
    """Numbers 1..K of the connected cells of a mask (R, C), 0 elsewhere, and K."""
    numbers, count = label(mask, structure=np.ones((3, 3)) if diagonal else None)
    return np.asarray(numbers, dtype=np.int64), int(count)


def smooth(values: FloatArray, certainty: FloatArray, sigma_cells: float) -> tuple[FloatArray, FloatArray]:
    """Normalised convolution (Knutsson and Westin, 1993) of a map (R, C): smoothed values, smoothed certainty.

    Values are 0 where nothing was measured within three sigma.
    """
    weight = gaussian_filter(certainty, sigma_cells, mode="constant", truncate=3.0)
    total = gaussian_filter(certainty * values, sigma_cells, mode="constant", truncate=3.0)
    return np.where(weight > 1e-9, total / np.maximum(weight, 1e-9), 0.0), weight
