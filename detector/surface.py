"""The road as a smooth surface: a robust quadratic along and across the corridor, and a slowly varying correction."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from detector.corridor import AHEAD_M, BEHIND_M, Corridor
from detector.ground import CROSS_BAND_M
from detector.robust import MAD_TO_SD, fit_tukey, quadratic_terms
from detector.types import FloatArray, IntArray

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
# Enough to know a median absolute deviation in every range and strip.
MAX_NOISE_HITS = 12_000
# Noise is measured by range and by strips of this width across: beside the lane lie gutters, verges and setts.
ZONE_M = 2.0
NOISE_RANGE_EDGES_M = np.array([0.0, 5.0, 8.0, 12.0, 18.0, 25.0, 35.0, 65.0])
# Residuals above this are obstacles, not noise.
NOISE_BAND_M = 0.1
# LiDAR range resolution; the noise of simulated clouds can be zero.
NOISE_FLOOR_M = 0.002
# Asphalt under real LiDARs spreads by 1.0 to 1.3 cm; more is a place that the surface does not fit, as before a car.
NOISE_CEILING_M = 0.018
MIN_NOISE_HITS = 30
NOISE_BINS = 200


@dataclass(frozen=True, slots=True)
class RoadSurface:
    """Height of the road over its profile at (along, across), and the noise of hits about it (1 sigma) by range and
    strip."""

    coefficients: FloatArray
    correction_m: FloatArray
    across_start_m: float
    noise_m: FloatArray

    def height_m(self, along_m: FloatArray, across_m: FloatArray) -> FloatArray:
        """Height (N,) over the profile at distances along and offsets across the path (N,)."""
        return np.asarray(_height(self.coefficients, self.correction_m, self.across_start_m, along_m, across_m))

    def noise_at(self, range_m: FloatArray, across_m: FloatArray) -> FloatArray:
        """Standard deviation (N,) of hits about the road at ranges and offsets across the path (N,)."""
        return np.asarray(_noise_at(self.noise_m, self.across_start_m, range_m, across_m))


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
    surface = first
    for _ in range(SOUND_ROUNDS):
        noise = _noise(surface, along_m, across_m, height_m)
        sound = _sound_weights(certainty, residual - surface.correction_m, noise, start)
        surface = RoadSurface(first.coefficients, _corrected(surface.correction_m, sound, residual), start, noise)
    return replace(surface, noise_m=_noise(surface, along_m, across_m, height_m))


def _corrected(correction: FloatArray, weights: FloatArray, residual: FloatArray) -> FloatArray:
    """The correction plus that of what it leaves (Tukey's twicing): alone it cuts off crests and fills troughs."""
    return correction + _correction(weights, residual - correction)


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
            sd = noise[_noise_bin(math.hypot(along, across)), _zone(across, start, noise.shape[1])]
            if abs(residual[row, column]) > max(OBSTACLE_SD * sd, OBSTACLE_MIN_M):
                for i in range(max(row - 1, 0), min(row + 2, rows)):
                    for j in range(max(column - 1, 0), min(column + 2, columns)):
                        weights[i, j] = 0.0
    return weights


def _correction(weights: FloatArray, residual: FloatArray) -> FloatArray:
    """Normalised convolution (Knutsson and Westin, 1993) of the cells' residuals; none far from any of them."""
    along, across = _kernel(KERNEL_ALONG_M), _kernel(KERNEL_ACROSS_M)
    return np.asarray(_blur_both(weights, weights * residual, along, across))


def _kernel(sigma_m: float) -> FloatArray:
    reach = math.ceil(KERNEL_REACH * sigma_m / CELL_M)
    steps = np.arange(-reach, reach + 1) * CELL_M
    return np.asarray(np.exp(-0.5 * np.square(steps / sigma_m)))


@njit(cache=True, nogil=True)
def _blur_both(weight: FloatArray, weighted: FloatArray, along: FloatArray, across: FloatArray) -> FloatArray:
    rows, columns = weight.shape
    reach_along, reach_across = len(along) // 2, len(across) // 2
    w, v = np.zeros((rows, columns)), np.zeros((rows, columns))
    for row in range(rows):
        for column in range(columns):
            if weight[row, column] == 0.0:
                continue
            for j in range(max(-reach_across, -column), min(reach_across + 1, columns - column)):
                w[row, column + j] += across[j + reach_across] * weight[row, column]
                v[row, column + j] += across[j + reach_across] * weighted[row, column]
    smooth_w, smooth_v = np.zeros((rows, columns)), np.zeros((rows, columns))
    for row in range(rows):
        for i in range(max(-reach_along, -row), min(reach_along + 1, rows - row)):
            k = along[i + reach_along]
            for column in range(columns):
                smooth_w[row, column] += k * w[row + i, column]
                smooth_v[row, column] += k * v[row + i, column]
    for row in range(rows):
        for column in range(columns):
            smooth_v[row, column] /= smooth_w[row, column] + 1e-3
    return smooth_v


@njit(cache=True, nogil=True)
def _height(
    coefficients: FloatArray, correction: FloatArray, start: float, along: FloatArray, across: FloatArray
) -> FloatArray:
    """Quadratic plus the bilinear interpolation of the correction."""
    rows, columns = correction.shape
    height = np.empty(len(along))
    for n in range(len(along)):
        row = min(max((along[n] + BEHIND_M) / CELL_M - 0.5, 0.0), rows - 1.001)
        column = min(max((across[n] - start) / CELL_M - 0.5, 0.0), columns - 1.001)
        i, j = int(row), int(column)
        u, v = row - i, column - j
        upper = correction[i, j] * (1.0 - v) + correction[i, j + 1] * v
        lower = correction[i + 1, j] * (1.0 - v) + correction[i + 1, j + 1] * v
        height[n] = _quadratic(coefficients, along[n], across[n]) + upper * (1.0 - u) + lower * u
    return height


@njit(cache=True, nogil=True)
def _noise_bin(range_m: float) -> int:
    last = len(NOISE_RANGE_EDGES_M) - 2
    for k in range(last, 0, -1):
        if range_m >= NOISE_RANGE_EDGES_M[k]:
            return k
    return 0


@njit(cache=True, nogil=True)
def _zone(across: float, start: float, zones: int) -> int:
    return min(max(int((across - start) / ZONE_M), 0), zones - 1)


@njit(cache=True, nogil=True)
def _noise_at(noise: FloatArray, start: float, range_m: FloatArray, across: FloatArray) -> FloatArray:
    found = np.empty(len(range_m))
    for i in range(len(range_m)):
        found[i] = noise[_noise_bin(range_m[i]), _zone(across[i], start, noise.shape[1])]
    return found


def _noise(surface: RoadSurface, along_m: FloatArray, across_m: FloatArray, height_m: FloatArray) -> FloatArray:
    """Noise by range and strip by the median absolute deviation; where few are hit, that of the whole range, and of the
    range before it."""
    chosen = slice(None, None, max(len(along_m) // MAX_NOISE_HITS, 1))
    along, across = along_m[chosen], across_m[chosen]
    deviation = np.abs(height_m[chosen] - surface.height_m(along, across))
    zones = max(math.ceil(surface.correction_m.shape[1] * CELL_M / ZONE_M), 1)
    return np.asarray(_noise_of(deviation, np.hypot(along, across), across, surface.across_start_m, zones))


@njit(cache=True, nogil=True)
def _noise_of(deviation: FloatArray, range_m: FloatArray, across: FloatArray, start: float, zones: int) -> FloatArray:
    bins = len(NOISE_RANGE_EDGES_M) - 1
    counts = np.zeros((bins, zones, NOISE_BINS), dtype=np.int64)
    for i in range(len(deviation)):
        if deviation[i] < NOISE_BAND_M:
            k = min(int(deviation[i] / NOISE_BAND_M * NOISE_BINS), NOISE_BINS - 1)
            counts[_noise_bin(range_m[i]), _zone(across[i], start, zones), k] += 1
    of_range = np.full(bins, NOISE_CEILING_M)
    first, known = True, NOISE_CEILING_M
    for b in range(bins):
        noise = _median_deviation(counts[b].sum(axis=0))
        if not math.isnan(noise):
            if first:
                of_range[:b] = noise
            first, known = False, noise
        of_range[b] = known
    found = np.empty((bins, zones))
    for b in range(bins):
        for zone in range(zones):
            noise = _median_deviation(counts[b, zone])
            found[b, zone] = of_range[b] if math.isnan(noise) else noise
    return found


@njit(cache=True, nogil=True)
def _median_deviation(counts: IntArray) -> float:
    """Standard deviation from a histogram of absolute deviations, NaN of too few."""
    total = counts.sum()
    if total < MIN_NOISE_HITS:
        return math.nan
    reached, k = 0, 0
    while reached + counts[k] < 0.5 * total:
        reached += counts[k]
        k += 1
    within = (0.5 * total - reached) / counts[k]
    noise = MAD_TO_SD * (k + within) * NOISE_BAND_M / NOISE_BINS
    return float(min(max(noise, NOISE_FLOOR_M), NOISE_CEILING_M))
