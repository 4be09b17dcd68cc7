"""Maps on a 2 cm grid about a place: smoothed counts and means of scattered samples, regions and contours."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.ndimage import label
from skimage.measure import find_contours

from detector.arrays import FloatArray, IntArray

CELL_M = 0.02
SIGMA_M = 0.03
# A mean farther than this from the nearest hit is extrapolation.
SUPPORT_SIGMAS = 2.8

Map = FloatArray


@dataclass(frozen=True, slots=True)
class Grid:
    """Square of cells about the origin; the first axis is x, the second y."""

    half_size_m: float

    @property
    def cells(self) -> int:
        """Number of cells along one side."""
        return round(2.0 * self.half_size_m / CELL_M)

    def kernel_at(self, distance_m: float, sigma_m: float) -> float:
        """Smoothed count that one hit makes at a distance from it."""
        return float((CELL_M / sigma_m) ** 2 / (2.0 * np.pi) * np.exp(-0.5 * (distance_m / sigma_m) ** 2))

    def centres_m(self) -> FloatArray:
        """Coordinate (G,) of the cells' centres along one axis."""
        return (np.arange(self.cells, dtype=np.float64) + 0.5) * CELL_M - self.half_size_m

    def cell_of(self, xy_m: FloatArray) -> tuple[IntArray, IntArray]:
        """Row and column (N,) of the cells of places (N, 2), those beyond the grid at its edge."""
        index = np.clip(np.floor((xy_m + self.half_size_m) / CELL_M).astype(np.int64), 0, self.cells - 1)
        return index[:, 0], index[:, 1]

    def inside(self, polygon_m: FloatArray) -> np.ndarray:
        """Mask (G, G) of the cells whose centre lies in a polygon (K, 2)."""
        return np.asarray(_fill((polygon_m + self.half_size_m) / CELL_M - 0.5, self.cells))


@njit(cache=True, nogil=True)
def _fill(corners: FloatArray, cells: int) -> np.ndarray:
    """Even-odd rule along each row of cells; corners (K, 2) in cells."""
    inside = np.zeros((cells, cells), dtype=np.bool_)
    for k in range(len(corners)):
        x0, y0 = corners[k - 1]
        x1, y1 = corners[k]
        if x0 > x1:
            x0, y0, x1, y1 = x1, y1, x0, y0
        for row in range(max(0, math.ceil(x0)), min(cells - 1, math.ceil(x1) - 1) + 1):
            crossing = y0 + (y1 - y0) * (row - x0) / (x1 - x0)
            for column in range(max(0, math.ceil(crossing)), cells):
                inside[row, column] = not inside[row, column]
    return inside


def mean_map(grid: Grid, count: Map, total: Map, sigma_m: float) -> Map:
    """Gaussian mean (G, G) from the smoothed number and sum of samples; 0, the road, where none is near."""
    return np.where(count > grid.kernel_at(SUPPORT_SIGMAS * sigma_m, sigma_m), total / np.maximum(count, 1e-12), 0.0)


def region_of(relief_m: Map, grid: Grid, threshold_m: float, seed_radius_m: float) -> np.ndarray | None:
    """Mask of the connected region above the threshold that has the most volume within the radius of the middle.

    Volume, so that a stone beside a hole's rim is not taken for it; near the middle, so that no kerb is.
    """
    labels, count = label(relief_m > threshold_m, structure=np.ones((3, 3), dtype=np.int64))
    if count == 0:
        return None
    centres = grid.centres_m()
    near = np.hypot(centres[:, None], centres[None, :]) < seed_radius_m
    volume = np.bincount(labels[near], weights=relief_m[near], minlength=count + 1)[1:]
    if volume.max() <= 0.0:
        return None
    return np.asarray(labels == int(np.argmax(volume)) + 1)


def contour_around(values: Map, level: float, grid: Grid, region: np.ndarray) -> FloatArray | None:
    """Closed contour (K, 2) of a map at a level that encloses most of a region's cells; None if none does."""
    best, best_share = None, 0.3
    for line in find_contours(np.pad(values, 1), level):
        polygon = (line - 0.5) * CELL_M - grid.half_size_m
        if not np.array_equal(line[0], line[-1]) or _area_m2(polygon) < best_share * region.sum() * CELL_M**2:
            continue
        share = (grid.inside(polygon) & region).sum() / max(int(region.sum()), 1)
        if share > best_share:
            best, best_share = polygon[:-1], share
    return best


def _area_m2(polygon: FloatArray) -> float:
    x, y = polygon.T
    return 0.5 * abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))
