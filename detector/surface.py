"""The road as a smooth surface: a robust quadratic along and across the corridor, and a slowly varying correction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from detector.corridor import AHEAD_M, BEHIND_M, Corridor
from detector.robust import MAD_TO_SD, fit_tukey, quadratic_terms, tukey_weight
from detector.types import FloatArray

CELL_M = 0.25
# The strip is evaluated this far beyond its edges, and no farther: a pavement would bend the road around a place.
MARGIN_M = 0.25
# A 6 % grade against the car's own plane, and a crown or kerb on top of it.
BAND_M = 0.3
BAND_GRADE = 0.06
MIN_CELLS = 30
MAX_CELLS = 4000
# Scales of the quadratic's coordinates, for conditioning.
ALONG_SCALE_M = 20.0
ACROSS_SCALE_M = 4.0
# Full width at half maximum 3.5 x 1.9 m: more than twice the largest hole, less than the waves of a road.
KERNEL_ALONG_M = 1.5
KERNEL_ACROSS_M = 0.8
# Hits a cell counts for at most, so that the dense near field does not rule.
MAX_CELL_WEIGHT = 4.0
# Cutoffs of the successive corrections: the road's waves first, then everything but the obstacles.
CORRECTION_CUTOFFS_M = (0.15, 0.06, 0.05)
NOISE_RANGE_EDGES_M = np.array([0.0, 5.0, 8.0, 12.0, 18.0, 25.0, 45.0])
# Residuals above this are obstacles, not noise.
NOISE_BAND_M = 0.1
# LiDAR range resolution; the noise of simulated clouds can be zero.
NOISE_FLOOR_M = 0.002
MIN_NOISE_HITS = 30


@dataclass(frozen=True, slots=True)
class RoadSurface:
    """Height of the road over (along, across), and the noise of hits about it by range (1 sigma, metres)."""

    coefficients: FloatArray
    correction_m: FloatArray
    across_start_m: float
    noise_m: FloatArray

    def height_m(self, along_m: FloatArray, across_m: FloatArray) -> FloatArray:
        """Height (N,) of the road in the sensor frame at road coordinates (N,)."""
        smooth = _terms(along_m, across_m) @ self.coefficients
        return smooth + _bilinear(self.correction_m, along_m, across_m, self.across_start_m)

    def noise_at(self, range_m: FloatArray) -> FloatArray:
        """Standard deviation (N,) of the residual of a road hit at horizontal range (N,)."""
        middle = 0.5 * (NOISE_RANGE_EDGES_M[1:] + NOISE_RANGE_EDGES_M[:-1])
        return np.interp(range_m, middle, self.noise_m)


def fit_surface(
    along_m: FloatArray, across_m: FloatArray, z_m: FloatArray, corridor: Corridor, sensor_height_m: float
) -> RoadSurface | None:
    """Surface through the points (N,) of a corridor, in the sensor frame; None where too little of a road is seen."""
    inside = corridor.contains(along_m, across_m, MARGIN_M)
    inside &= np.abs(z_m + sensor_height_m) < BAND_M + BAND_GRADE * np.hypot(along_m, across_m)
    along, across, z = along_m[inside], across_m[inside], z_m[inside]
    start, shape = _grid(corridor)
    count, mean_z = _cell_means(along, across, z, start, shape)
    coefficients = _fit_quadratic(count, mean_z, corridor, start)
    if coefficients is None:
        return None
    correction = _fit_correction(count, mean_z, coefficients, start)
    surface = RoadSurface(coefficients, correction, start, np.empty(0))
    on_road = corridor.contains(along, across)
    residual = z[on_road] - surface.height_m(along[on_road], across[on_road])
    noise = _noise_by_range(np.hypot(along[on_road], across[on_road]), residual)
    return RoadSurface(coefficients, correction, start, noise)


def _grid(corridor: Corridor) -> tuple[float, tuple[int, int]]:
    start = corridor.right_m - MARGIN_M
    columns = int(np.ceil((corridor.left_m + MARGIN_M - start) / CELL_M)) + 1
    return start, (int((AHEAD_M + BEHIND_M) / CELL_M), columns)


def _cell_means(
    along: FloatArray, across: FloatArray, z: FloatArray, start: float, shape: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    row = ((along + BEHIND_M) / CELL_M).astype(np.int64)
    cell = row * shape[1] + ((across - start) / CELL_M).astype(np.int64)
    count = np.bincount(cell, minlength=shape[0] * shape[1]).astype(np.float64)
    total = np.bincount(cell, weights=z, minlength=shape[0] * shape[1])
    return count.reshape(shape), (total / np.maximum(count, 1.0)).reshape(shape)


def _cell_centres(shape: tuple[int, ...], start: float) -> tuple[FloatArray, FloatArray]:
    along = (np.arange(shape[0]) + 0.5) * CELL_M - BEHIND_M
    across = (np.arange(shape[1]) + 0.5) * CELL_M + start
    return np.repeat(along, shape[1]), np.tile(across, shape[0])


def _terms(along_m: FloatArray, across_m: FloatArray) -> FloatArray:
    return quadratic_terms(along_m / ALONG_SCALE_M, across_m / ACROSS_SCALE_M)


def _fit_quadratic(count: FloatArray, mean_z: FloatArray, corridor: Corridor, start: float) -> FloatArray | None:
    along, across = _cell_centres(count.shape, start)
    chosen = np.flatnonzero((count.ravel() > 0) & corridor.contains(along, across))
    if chosen.size < MIN_CELLS:
        return None
    chosen = chosen[:: -(-chosen.size // MAX_CELLS)]
    weight = np.sqrt(np.minimum(count.ravel()[chosen], MAX_CELL_WEIGHT))
    terms = _terms(along[chosen], across[chosen])
    return fit_tukey(terms, mean_z.ravel()[chosen], weight, cutoff_sd=4.685, floor_sd=0.01)


def _fit_correction(count: FloatArray, mean_z: FloatArray, coefficients: FloatArray, start: float) -> FloatArray:
    """Robust normalised convolution (Knutsson and Westin, 1993) of the cells' residuals."""
    along, across = _cell_centres(count.shape, start)
    residual = mean_z - (_terms(along, across) @ coefficients).reshape(count.shape)
    certainty = np.minimum(count, MAX_CELL_WEIGHT)
    correction = np.zeros_like(residual)
    sigma = (KERNEL_ALONG_M / CELL_M, KERNEL_ACROSS_M / CELL_M)
    for cutoff in CORRECTION_CUTOFFS_M:
        weight = certainty * tukey_weight(residual - correction, cutoff)
        total = gaussian_filter(weight, sigma, mode="constant", truncate=3.0)
        # Far from any hit the correction fades to none.
        correction = gaussian_filter(weight * residual, sigma, mode="constant", truncate=3.0) / (total + 1e-3)
    return correction


def _bilinear(grid: FloatArray, along_m: FloatArray, across_m: FloatArray, start: float) -> FloatArray:
    row = np.clip((along_m + BEHIND_M) / CELL_M - 0.5, 0.0, grid.shape[0] - 1.001)
    column = np.clip((across_m - start) / CELL_M - 0.5, 0.0, grid.shape[1] - 1.001)
    i, j = row.astype(np.int64), column.astype(np.int64)
    u, v = row - i, column - j
    upper = grid[i, j] * (1.0 - v) + grid[i, j + 1] * v
    lower = grid[i + 1, j] * (1.0 - v) + grid[i + 1, j + 1] * v
    return np.asarray(upper * (1.0 - u) + lower * u)


def _noise_by_range(range_m: FloatArray, residual_m: FloatArray) -> FloatArray:
    """Noise of each range bin by the median absolute deviation; a bin with few hits takes its nearer neighbour's."""
    near = np.abs(residual_m) < NOISE_BAND_M
    bin_of = np.digitize(range_m[near], NOISE_RANGE_EDGES_M) - 1
    noise = np.full(NOISE_RANGE_EDGES_M.size - 1, np.nan)
    for k in range(noise.size):
        values = residual_m[near][bin_of == k]
        if values.size >= MIN_NOISE_HITS:
            noise[k] = max(MAD_TO_SD * float(np.median(np.abs(values))), NOISE_FLOOR_M)
    known = np.flatnonzero(np.isfinite(noise))
    if known.size == 0:
        return np.full(noise.size, NOISE_BAND_M / 3.0)
    return noise[known[np.clip(np.searchsorted(known, np.arange(noise.size), side="right") - 1, 0, None)]]
