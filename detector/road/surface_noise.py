"""How far hits on the road lie off its surface, by range and by strip across: the noise that deviations are told by."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from detector.arrays import FloatArray, IntArray
from detector.road.robust import MAD_TO_SD

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


@njit(cache=True, nogil=True)
def noise_bin(range_m: float) -> int:
    """Number of the noise's range that a distance falls in."""
    last = len(NOISE_RANGE_EDGES_M) - 2
    for k in range(last, 0, -1):
        if range_m >= NOISE_RANGE_EDGES_M[k]:
            return k
    return 0


@njit(cache=True, nogil=True)
def zone(across_m: float, start_m: float, zones: int) -> int:
    """Number of the strip that an offset falls in, the first of which begins at `start_m`."""
    return min(max(int((across_m - start_m) / ZONE_M), 0), zones - 1)


@njit(cache=True, nogil=True)
def noise_places(range_m: FloatArray, across_m: FloatArray, start_m: float, zones: int) -> IntArray:
    """Range and strip (N,) of hits as one number: that of the range times `zones`, plus that of the strip."""
    place = np.empty(len(range_m), dtype=np.int64)
    for i in range(len(range_m)):
        place[i] = noise_bin(range_m[i]) * zones + zone(across_m[i], start_m, zones)
    return place


@njit(cache=True, nogil=True)
def noise_at(noise_m: FloatArray, start_m: float, range_m: FloatArray, across_m: FloatArray) -> FloatArray:
    """Noise (N,) at ranges and offsets (N,), looked up by range and strip."""
    found = np.empty(len(range_m))
    for i in range(len(range_m)):
        found[i] = noise_m[noise_bin(range_m[i]), zone(across_m[i], start_m, noise_m.shape[1])]
    return found


@njit(cache=True, nogil=True)
def measured_noise(deviation_m: FloatArray, place: IntArray, zones: int) -> FloatArray:
    """Noise (ranges, zones) by the median absolute deviation of the hits (N,) of each place; where few are hit, that
    of the whole range, and of the range before it."""
    bins = len(NOISE_RANGE_EDGES_M) - 1
    counts = np.zeros((bins * zones, NOISE_BINS), dtype=np.int64)
    for i in range(len(deviation_m)):
        if deviation_m[i] < NOISE_BAND_M:
            counts[place[i], min(int(deviation_m[i] / NOISE_BAND_M * NOISE_BINS), NOISE_BINS - 1)] += 1
    of_range = np.full(bins, NOISE_CEILING_M)
    first, known = True, NOISE_CEILING_M
    for b in range(bins):
        noise = _median_deviation(counts[b * zones : (b + 1) * zones].sum(axis=0))
        if not math.isnan(noise):
            if first:
                of_range[:b] = noise
            first, known = False, noise
        of_range[b] = known
    found = np.empty((bins, zones))
    for b in range(bins):
        for k in range(zones):
            noise = _median_deviation(counts[b * zones + k])
            found[b, k] = of_range[b] if math.isnan(noise) else noise
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
