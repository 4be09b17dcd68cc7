"""What each ring of one sweep adds to the road's height: real rings are off by a centimetre for good.

Within a ring an HDL-64E's hits lie 1 to 3 mm about a road, between its rings 1 cm. Rings are told apart by their
elevation alone; where they cannot be (a tilted frame, a cloud of several sensors) nothing is taken out.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from detector.arrays import FloatArray, IntArray
from detector.road.ring_bias import BIN_RAD, EMPTY_BINS

# What is searched for rings; above and below no ring meets a road within 45 m.
LOWEST_RAD, HIGHEST_RAD = math.radians(-60.0), math.radians(15.0)
# Undoing a car's turn within a sweep spreads an HDL-64E's rings over 0.2 degrees; more is several rings in one.
MAX_RING_BINS = 15
# Beside the car, undoing its motion bends the rings by degrees.
MAX_BESIDE = 1.5
# A ring's hits are compared by sectors, strips of the road ahead and behind, of which most are without obstacles.
SECTOR_M = 2.0
MIN_SECTOR_HITS = 8
MIN_SECTORS = 3
# Hits beyond this are obstacles; a ring beyond half of it is a hump or a kerb that crosses the road.
BAND_M = 0.06
MAX_OFFSET_M = 0.03
STEP_M = 0.001


def sweep_ring_offsets(
    points_m: FloatArray, indices: IntArray, along_m: FloatArray, across_m: FloatArray, residual_m: FloatArray
) -> FloatArray:
    """Height (S,) by which the ring of each point of the road lies off it, from its residuals (S,) to a first surface:
    the median over the sectors of the road of the medians in them; 0 of rings that are hardly seen.

    `points_m` (N, 3) are those of the sweep in the frame `sensor`, `indices` (S,) which of them are the road's,
    `along_m` and `across_m` (S,) where on it.
    """
    if len(indices) == 0:
        return np.zeros(0)
    ring, rings = _rings(points_m, indices, residual_m)
    sector, sectors = _sectors(along_m, across_m)
    return np.asarray(_offsets(ring, rings, sector, sectors, residual_m))


@njit(cache=True, nogil=True)
def _sectors(along: FloatArray, across: FloatArray) -> tuple[IntArray, int]:
    """Sector (S,) of each point, and their number."""
    rightmost, sectors = across.min(), 0
    sector = np.empty(len(along), dtype=np.int64)
    for i in range(len(along)):
        lane = int((across[i] - rightmost) / SECTOR_M)
        sector[i] = 2 * lane + (along[i] > 0.0)
        sectors = max(sectors, 2 * lane + 2)
    return sector, sectors


@njit(cache=True, nogil=True)
def _rings(points: FloatArray, indices: IntArray, residual: FloatArray) -> tuple[IntArray, int]:
    """Ring (S,) of each of the points at `indices`, -1 of none, and their number: heaps of the elevations of the road
    before and behind the car with gaps between them."""
    bins = int((HIGHEST_RAD - LOWEST_RAD) / BIN_RAD) + 1
    ring = np.full(len(indices), -1, dtype=np.int64)
    filled = np.zeros(bins, dtype=np.bool_)
    for i in range(len(indices)):
        x, y, z = points[indices[i]]
        k = int((math.atan2(z, math.sqrt(x * x + y * y)) - LOWEST_RAD) / BIN_RAD)
        if 0 <= k < bins:
            ring[i] = k
            filled[k] |= abs(residual[i]) < BAND_M and abs(y) < MAX_BESIDE * abs(x)
    number = np.full(bins, -1, dtype=np.int64)
    rings, first, last = 0, -1, -1
    for k in range(bins):
        if not filled[k]:
            continue
        if last < 0 or k - last > EMPTY_BINS:
            rings, first = rings + 1, k
        last = k
        number[first : k + 1] = rings - 1 if k - first < MAX_RING_BINS else -1
    for i in range(len(ring)):
        if ring[i] >= 0:
            ring[i] = number[ring[i]]
    return ring, rings


@njit(cache=True, nogil=True)
def _offsets(ring: IntArray, rings: int, sector: IntArray, sectors: int, residual: FloatArray) -> FloatArray:
    steps = int(2.0 * BAND_M / STEP_M)
    counts = np.zeros((rings, sectors, steps), dtype=np.int32)
    for i in range(len(ring)):
        k = math.floor((residual[i] + BAND_M) / STEP_M)
        if ring[i] >= 0 and 0 <= k < steps:
            counts[ring[i], sector[i], k] += 1
    offset = np.zeros(rings)
    medians = np.empty(sectors)
    for r in range(rings):
        known = 0
        for s in range(sectors):
            hits = counts[r, s].sum()
            if hits >= MIN_SECTOR_HITS:
                medians[known] = _median(counts[r, s], hits)
                known += 1
        if known >= MIN_SECTORS:
            offset[r] = _nearest_median(np.sort(medians[:known]))
    found = np.zeros(len(ring))
    for i in range(len(ring)):
        if ring[i] >= 0 and abs(offset[ring[i]]) < MAX_OFFSET_M:
            found[i] = offset[ring[i]]
    return found


@njit(cache=True, nogil=True)
def _median(counts: IntArray, hits: int) -> float:
    reached, k = 0, 0
    while reached + counts[k] < 0.5 * hits:
        reached += counts[k]
        k += 1
    return float((k + (0.5 * hits - reached) / counts[k]) * STEP_M - BAND_M)


@njit(cache=True, nogil=True)
def _nearest_median(values: FloatArray) -> float:
    """Of two middle values that nearer to none: a hump across the road ahead is half of what a ring sees."""
    lower, upper = values[(len(values) - 1) // 2], values[len(values) // 2]
    return float(lower if abs(lower) < abs(upper) else upper)
