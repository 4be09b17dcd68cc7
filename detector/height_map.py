"""Maps on a 2 cm grid about a place: smoothed counts and means of scattered samples, regions and contours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, label
from skimage.draw import polygon2mask
from skimage.measure import find_contours

from detector.types import FloatArray

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

    def smooth_count(self, xy_m: FloatArray, weight: FloatArray | None = None, sigma_m: float = SIGMA_M) -> Map:
        """Sum (G, G) of the (weighted) samples (N, 2), each spread by a Gaussian."""
        n = self.cells
        index = np.floor((xy_m + self.half_size_m) / CELL_M).astype(np.int64)
        inside = ((index >= 0) & (index < n)).all(axis=1)
        cell = index[inside, 0] * n + index[inside, 1]
        chosen = None if weight is None else weight[inside]
        total = np.bincount(cell, weights=chosen, minlength=n * n).astype(np.float64).reshape(n, n)
        return np.asarray(gaussian_filter(total, sigma_m / CELL_M, mode="constant", truncate=3.5), dtype=np.float64)

    def cell_means(self, xy_m: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Centres (M, 2) of the cells that were hit and the mean (M,) of the samples in each."""
        index = np.floor((xy_m + self.half_size_m) / CELL_M).astype(np.int64)
        hit, cell = np.unique(index, axis=0, return_inverse=True)
        mean = np.bincount(cell.ravel(), weights=values) / np.bincount(cell.ravel())
        centres = (hit.astype(np.float64) + 0.5) * CELL_M - self.half_size_m
        return centres, np.asarray(mean, dtype=np.float64)

    def kernel_at(self, distance_m: float, sigma_m: float = SIGMA_M) -> float:
        """Smoothed count that one hit makes at a distance from it."""
        return float((CELL_M / sigma_m) ** 2 / (2.0 * np.pi) * np.exp(-0.5 * (distance_m / sigma_m) ** 2))

    def centres_m(self) -> FloatArray:
        """Coordinate (G,) of the cells' centres along one axis."""
        return (np.arange(self.cells, dtype=np.float64) + 0.5) * CELL_M - self.half_size_m

    def inside(self, polygon_m: FloatArray) -> np.ndarray:
        """Mask (G, G) of the cells whose centre lies in a polygon (K, 2)."""
        return np.asarray(polygon2mask((self.cells, self.cells), (polygon_m + self.half_size_m) / CELL_M - 0.5))


def smooth_mean(grid: Grid, xy_m: FloatArray, values: FloatArray) -> Map:
    """Gaussian mean (G, G) of samples; 0, the road, where none is near."""
    count = grid.smooth_count(xy_m)
    total = grid.smooth_count(xy_m, values)
    return np.where(count > grid.kernel_at(SUPPORT_SIGMAS * SIGMA_M), total / np.maximum(count, 1e-12), 0.0)


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
