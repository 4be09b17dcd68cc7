"""The road as a smooth surface: a robust quadratic along and across the corridor, and a slowly varying correction."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numba import njit

from detector.arrays import FloatArray, IntArray
from detector.road.corridor import AHEAD_M, BEHIND_M, Corridor
from detector.road.ground import CROSS_BAND_M
from detector.road.robust import fit_tukey, quadratic_terms
from detector.road.surface_noise import MAX_NOISE_HITS, ZONE_M, measured_noise, noise_at, noise_bin, noise_places, zone

CELL_M = 0.25
# The strip is evaluated this far beyond its edges, and no farther: a pavement would bend the road around a place.
MARGIN_M = 0.25
# The road's own hits in a cell lie this close together: noise, and 5 % of fall over the cell.
LAYER_M = 0.08
MIN_CELLS = 30
MAX_CELLS = 2000
# Scales of the quadratic's coordinates, for conditioning.
ALONG_SCALE_M = 20.0
ACROSS_SCALE_M = 4.0
# Full width at half maximum 3.5 x 1.9 m: more than twice the largest hole, less than the waves of a road.
KERNEL_ALONG_M = 1.5
KERNEL_ACROSS_M = 0.8
KERNEL_REACH = 2.5
# Hits a cell counts for at most, so that the dense near field does not rule.
MAX_CELL_WEIGHT = 4.0
# Cutoffs of the successive corrections: the road's waves first, then everything but the obstacles.
CORRECTION_CUTOFFS_M = (0.3, 0.12, 0.06)
# What rises is left out sooner than what sinks: along a kerb the surface is the road's and not the mean of both.
RISE_SHARE = 0.5
# Cells off the road by more than this many standard deviations of their range are obstacles: they and their neighbours
# do not take part in the last correction, or it would follow a low bump.
OBSTACLE_SD = 2.5
OBSTACLE_MIN_M = 0.015
SOUND_ROUNDS = 2


@dataclass(frozen=True, slots=True)
class RoadSurface:
    """Height of the road over its profile at (along, across), and the noise of hits about it (1 sigma) by range and
    strip."""

    coefficients: FloatArray
    correction_m: FloatArray
    across_start_m: float
    noise_m: FloatArray

    def residual_m(self, along_m: FloatArray, across_m: FloatArray, height_m: FloatArray) -> FloatArray:
        """What of heights (N,) over the profile is left over the surface, at distances along and offsets across the
        path (N,)."""
        start = self.across_start_m
        return np.asarray(_residual(self.coefficients, self.correction_m, start, along_m, across_m, height_m))

    def noise_at(self, range_m: FloatArray, across_m: FloatArray) -> FloatArray:
        """Standard deviation (N,) of hits about the road at ranges and offsets across the path (N,)."""
        return np.asarray(noise_at(self.noise_m, self.across_start_m, range_m, across_m))


def first_surface(
    along_m: FloatArray, across_m: FloatArray, height_m: FloatArray, corridor: Corridor
) -> RoadSurface | None:
    """Surface through points (N,) of a corridor and its margin, before obstacles are left out, its noise not yet known;
    None where too little of a road is seen."""
    start = corridor.right_m - MARGIN_M
    columns = math.ceil((corridor.left_m + MARGIN_M - start) / CELL_M) + 1
    count, mean = _cell_means(along_m, across_m, height_m, start, columns)
    coefficients = _fit_quadratic(count, mean, start)
    if coefficients is None:
        return None
    residual = mean - _plane(coefficients, count.shape[0], columns, start)
    certainty = np.minimum(count, MAX_CELL_WEIGHT)
    correction = np.zeros_like(residual)
    for cutoff in CORRECTION_CUTOFFS_M:
        correction = _corrected(correction, _tukey_weights(certainty, residual - correction, cutoff), residual)
    return RoadSurface(coefficients, correction, start, np.empty(0))


def sound_surface(first: RoadSurface, along_m: FloatArray, across_m: FloatArray, height_m: FloatArray) -> RoadSurface:
    """The surface through the same points without those of obstacles, and the noise about it."""
    start = first.across_start_m
    count, mean = _cell_means(along_m, across_m, height_m, start, first.correction_m.shape[1])
    residual = mean - _plane(first.coefficients, *count.shape, start)
    certainty = np.minimum(count, MAX_CELL_WEIGHT)
    sample = _noise_sample(first, along_m, across_m, height_m)
    surface = first
    for _ in range(SOUND_ROUNDS):
        noise = sample.noise_about(surface)
        sound = _sound_weights(certainty, residual - surface.correction_m, noise, start)
        surface = RoadSurface(first.coefficients, _corrected(surface.correction_m, sound, residual), start, noise)
    return replace(surface, noise_m=sample.noise_about(surface))


@dataclass(frozen=True, slots=True)
class _NoiseSample:
    """Hits (N,) that the noise is measured by, and the place of each (N,) in it."""

    along_m: FloatArray
    across_m: FloatArray
    height_m: FloatArray
    place: IntArray
    zones: int

    def noise_about(self, surface: RoadSurface) -> FloatArray:
        """Noise (ranges, zones) of the hits about a surface."""
        deviation = np.abs(surface.residual_m(self.along_m, self.across_m, self.height_m))
        return np.asarray(measured_noise(deviation, self.place, self.zones))


def _noise_sample(
    surface: RoadSurface, along_m: FloatArray, across_m: FloatArray, height_m: FloatArray
) -> _NoiseSample:
    chosen = slice(None, None, max(len(along_m) // MAX_NOISE_HITS, 1))
    along, across, height = (np.ascontiguousarray(values[chosen]) for values in (along_m, across_m, height_m))
    zones = max(math.ceil(surface.correction_m.shape[1] * CELL_M / ZONE_M), 1)
    return _NoiseSample(
        along, across, height, noise_places(np.hypot(along, across), across, surface.across_start_m, zones), zones
    )


@njit(cache=True, nogil=True)
def _cell_means(
    along: FloatArray, across: FloatArray, height: FloatArray, start: float, columns: int
) -> tuple[FloatArray, FloatArray]:
    """Hits and mean height of the lowest layer of each cell: of a kerb or a bumper over the road, the road's."""
    rows = int((AHEAD_M + BEHIND_M) / CELL_M)
    cell = np.full(len(along), -1, dtype=np.int64)
    lowest = np.full(rows * columns, np.inf)
    for i in range(len(along)):
        row, column = int((along[i] + BEHIND_M) / CELL_M), int((across[i] - start) / CELL_M)
        if 0 <= row < rows and 0 <= column < columns and height[i] < CROSS_BAND_M:
            cell[i] = row * columns + column
            lowest[cell[i]] = min(lowest[cell[i]], height[i])
    count, total = np.zeros(rows * columns), np.zeros(rows * columns)
    for i in range(len(along)):
        if cell[i] >= 0 and height[i] < lowest[cell[i]] + LAYER_M:
            count[cell[i]] += 1.0
            total[cell[i]] += height[i]
    for k in range(rows * columns):
        if count[k] > 0.0:
            total[k] /= count[k]
    return count.reshape((rows, columns)), total.reshape((rows, columns))


def _fit_quadratic(count: FloatArray, mean: FloatArray, start: float) -> FloatArray | None:
    chosen = np.flatnonzero(count)
    if chosen.size < MIN_CELLS:
        return None
    chosen = chosen[:: -(-chosen.size // MAX_CELLS)]
    rows, columns = np.divmod(chosen, count.shape[1])
    along, across = (rows + 0.5) * CELL_M - BEHIND_M, (columns + 0.5) * CELL_M + start
    weight = np.sqrt(np.minimum(count.ravel()[chosen], MAX_CELL_WEIGHT))
    terms = quadratic_terms(along / ALONG_SCALE_M, across / ACROSS_SCALE_M)
    return fit_tukey(terms, mean.ravel()[chosen], weight, cutoff_sd=4.685, floor_sd=0.01)


@njit(cache=True, nogil=True)
def _plane(coefficients: FloatArray, rows: int, columns: int, start: float) -> FloatArray:
    heights = np.empty((rows, columns))
    for row in range(rows):
        for column in range(columns):
            heights[row, column] = _quadratic(
                coefficients, (row + 0.5) * CELL_M - BEHIND_M, (column + 0.5) * CELL_M + start
            )
    return heights


@njit(cache=True, nogil=True)
def _quadratic(coefficients: FloatArray, along: float, across: float) -> float:
    x, y = along / ALONG_SCALE_M, across / ACROSS_SCALE_M
    a, b, c, d, e, f = coefficients
    return float(a + b * x + c * y + d * x * x + e * x * y + f * y * y)


@njit(cache=True, nogil=True)
def _tukey_weights(certainty: FloatArray, residual: FloatArray, cutoff: float) -> FloatArray:
    weights = np.zeros_like(certainty)
    for row in range(certainty.shape[0]):
        for column in range(certainty.shape[1]):
            u = residual[row, column] / (cutoff if residual[row, column] < 0.0 else RISE_SHARE * cutoff)
            if certainty[row, column] > 0.0 and abs(u) < 1.0:
                weights[row, column] = certainty[row, column] * (1.0 - u * u) ** 2
    return weights


@njit(cache=True, nogil=True)
def _sound_weights(certainty: FloatArray, residual: FloatArray, noise: FloatArray, start: float) -> FloatArray:
    """Weights without the cells of obstacles and their neighbours."""
    rows, columns = certainty.shape
    weights = certainty.copy()
    for row in range(rows):
        along = (row + 0.5) * CELL_M - BEHIND_M
        for column in range(columns):
            if certainty[row, column] == 0.0:
                continue
            across = (column + 0.5) * CELL_M + start
            sd = noise[noise_bin(math.hypot(along, across)), zone(across, start, noise.shape[1])]
            if abs(residual[row, column]) > max(OBSTACLE_SD * sd, OBSTACLE_MIN_M):
                for i in range(max(row - 1, 0), min(row + 2, rows)):
                    for j in range(max(column - 1, 0), min(column + 2, columns)):
                        weights[i, j] = 0.0
    return weights


def _corrected(correction: FloatArray, weights: FloatArray, residual: FloatArray) -> FloatArray:
    """The correction plus that of what it leaves (Tukey's twicing): alone it cuts off crests and fills troughs."""
    return np.asarray(_smoothed(correction, weights, residual, _kernel(KERNEL_ALONG_M), _kernel(KERNEL_ACROSS_M)))


@cache
def _kernel(sigma_m: float) -> FloatArray:
    reach = math.ceil(KERNEL_REACH * sigma_m / CELL_M)
    steps = np.arange(-reach, reach + 1) * CELL_M
    return np.asarray(np.exp(-0.5 * np.square(steps / sigma_m)))


@njit(cache=True, nogil=True)
def _smoothed(
    correction: FloatArray, weight: FloatArray, residual: FloatArray, along: FloatArray, across: FloatArray
) -> FloatArray:
    """The correction plus the normalised convolution (Knutsson and Westin, 1993) of what it leaves of the cells'
    residuals; nothing is added far from any of them."""
    rows, columns = weight.shape
    reach_along, reach_across = len(along) // 2, len(across) // 2
    w, v = np.zeros((rows, columns)), np.zeros((rows, columns))
    is_seen = np.zeros(rows, dtype=np.bool_)
    for row in range(rows):
        is_seen[row] = weight[row].any()
        if is_seen[row]:
            weighted = weight[row] * (residual[row] - correction[row])
            for j in range(reach_across, -reach_across - 1, -1):
                _add_shifted(w[row], across[j + reach_across], weight[row], j)
                _add_shifted(v[row], across[j + reach_across], weighted, j)
    smoothed, total, certainty = np.empty((rows, columns)), np.empty(columns), np.empty(columns)
    for row in range(rows):
        total[:], certainty[:] = 0.0, 0.0
        for i in range(max(-reach_along, -row), min(reach_along + 1, rows - row)):
            if is_seen[row + i]:
                factor = along[i + reach_along]
                for column in range(columns):
                    certainty[column] += factor * w[row + i, column]
                    total[column] += factor * v[row + i, column]
        for column in range(columns):
            smoothed[row, column] = correction[row, column] + total[column] / (certainty[column] + 1e-3)
    return smoothed


@njit(cache=True, nogil=True)
def _add_shifted(total: FloatArray, factor: float, values: FloatArray, shift: int) -> None:
    """Adds `factor` times the values (N,), moved by `shift` places, to the total (N,)."""
    first, last = max(shift, 0), len(total) + min(shift, 0)
    target, source = total[first:last], values[first - shift : last - shift]
    for k in range(len(target)):
        target[k] += factor * source[k]


@njit(cache=True, nogil=True)
def _residual(
    coefficients: FloatArray,
    correction: FloatArray,
    start: float,
    along: FloatArray,
    across: FloatArray,
    height: FloatArray,
) -> FloatArray:
    """Heights less the quadratic and the bilinear interpolation of the correction."""
    rows, columns = correction.shape
    residual = np.empty(len(along))
    for n in range(len(along)):
        row = min(max((along[n] + BEHIND_M) / CELL_M - 0.5, 0.0), rows - 1.001)
        column = min(max((across[n] - start) / CELL_M - 0.5, 0.0), columns - 1.001)
        i, j = int(row), int(column)
        u, v = row - i, column - j
        upper = correction[i, j] * (1.0 - v) + correction[i, j + 1] * v
        lower = correction[i + 1, j] * (1.0 - v) + correction[i + 1, j + 1] * v
        residual[n] = height[n] - (_quadratic(coefficients, along[n], across[n]) + upper * (1.0 - u) + lower * u)
    return residual
