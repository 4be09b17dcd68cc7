"""What each ring of a LiDAR adds to its ranges, from hits on the road: real rings are off by centimetres for good."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from detector.arrays import FloatArray, IntArray

# Rings lie 0.3 degrees and more apart, the hits of one within hundredths, once the sensor's roll is taken out.
BIN_RAD = math.radians(0.02)
EMPTY_BINS = 3
# Elevation against azimuth: crossfall and a swaying body roll a sensor by up to 2.5 degrees.
MAX_SLOPE, SLOPES = 0.045, 46
# So many hits of a sweep show its roll.
SLOPE_HITS = 400
# A ring with fewer hits on the road says nothing of its bias.
MIN_RING_HITS = 4
CUTOFF_SD = 3.0


def number_rings(from_sensor_m: FloatArray, middle_m: FloatArray, starts: IntArray, on_road: np.ndarray) -> IntArray:
    """Number (N,) of the ring of each hit, different in every frame (0 in one without road).

    Hits are vectors (N, 3) from the sensor's place; `middle_m` (F, 2) is that to the middle of the window, `starts`
    (F + 1,) where each frame begins. A frame's rings are the heaps of its elevations, seen along the azimuth's slope;
    what is off the road, and so between rings, goes to the nearest.
    """
    return np.asarray(_number(from_sensor_m, middle_m, starts, on_road, MAX_SLOPE, SLOPES))


def ring_offsets(ring: IntArray, residual_m: FloatArray, on_road: np.ndarray) -> FloatArray:
    """Height (N,) by which each hit's ring lies off the road, shrunk by how well the ring is known.

    The means of rings about the road vary by noise, known from the spread within rings, and by bias; only the share
    that is bias is taken (empirical Bayes): none for a sensor without bias.
    """
    count = int(ring.max(initial=-1)) + 1
    mean, variance, members = _means(ring[on_road], residual_m[on_road], count)
    known = members >= MIN_RING_HITS
    if known.sum() < 2:
        return np.zeros(len(ring))
    noise = variance / np.maximum(members, 1)
    bias_variance = max(float(np.mean(mean[known] ** 2 - noise[known])), 0.0)
    offset = np.where(known, mean * bias_variance / np.maximum(bias_variance + noise, 1e-12), 0.0)
    return np.asarray(offset[ring])


def _means(ring: IntArray, values: FloatArray, count: int) -> tuple[FloatArray, float, IntArray]:
    """Mean (count,) of the values of each ring, their variance within rings, and their number (count,).

    Taken twice, the second time without what lies off its ring: pebbles, and rims that the mask of the road missed.
    """
    members = np.bincount(ring, minlength=count)
    mean = np.bincount(ring, weights=values, minlength=count) / np.maximum(members, 1)
    deviation = values - mean[ring]
    sd = 1.4826 * float(np.median(np.abs(deviation))) if deviation.size else 0.0
    kept = np.abs(deviation) <= CUTOFF_SD * sd
    members = np.bincount(ring[kept], minlength=count)
    mean = np.bincount(ring[kept], weights=values[kept], minlength=count) / np.maximum(members, 1)
    return mean, float(np.mean(np.square(values[kept] - mean[ring[kept]]))) if kept.any() else 0.0, members


@njit(cache=True, nogil=True)
def _number(
    from_sensor: FloatArray, middle: FloatArray, starts: IntArray, on_road: np.ndarray, max_slope: float, slopes: int
) -> IntArray:
    ring = np.zeros(len(from_sensor), dtype=np.int64)
    used = 0
    for frame in range(starts.size - 1):
        first, last = starts[frame], starts[frame + 1]
        if not on_road[first:last].any():
            continue
        mx, my = middle[frame, 0], middle[frame, 1]
        elevation, azimuth = np.empty(last - first), np.empty(last - first)
        for i in range(first, last):
            x, y, z = from_sensor[i, 0], from_sensor[i, 1], from_sensor[i, 2]
            elevation[i - first] = math.atan2(z, math.sqrt(x * x + y * y))
            azimuth[i - first] = math.atan2(y * mx - x * my, x * mx + y * my)
        widest = max_slope * np.abs(azimuth).max() + BIN_RAD
        low = elevation.min() - widest
        bins = int((elevation.max() + widest - low) / BIN_RAD) + 2
        road = on_road[first:last]
        slope = _sharpest(elevation[road] - low, azimuth[road], bins, max_slope, slopes)
        used = _heaps(elevation - low - slope * azimuth, road, bins, used, ring[first:last])
    return ring


@njit(cache=True, nogil=True)
def _sharpest(elevation: FloatArray, azimuth: FloatArray, bins: int, max_slope: float, slopes: int) -> float:
    """The slope along which the histogram of elevations has the largest sum of squares."""
    stride = max(1, elevation.size // SLOPE_HITS)
    best, best_score = 0.0, -1.0
    for step in range(slopes):
        slope = max_slope * (2.0 * step / (slopes - 1) - 1.0)
        counts = np.zeros(bins)
        for i in range(0, elevation.size, stride):
            counts[int((elevation[i] - slope * azimuth[i]) / BIN_RAD)] += 1.0
        score = (counts * counts).sum()
        if score > best_score:
            best, best_score = slope, score
    return best


@njit(cache=True, nogil=True)
def _heaps(elevation: FloatArray, on_road: np.ndarray, bins: int, used: int, ring: IntArray) -> int:
    """Number the hits of one frame from `used` on, a new ring after a gap between hits on the road; what is no road
    goes to the nearest ring. Returns the first number not used."""
    filled = np.zeros(bins, dtype=np.bool_)
    for i in range(elevation.size):
        if on_road[i]:
            filled[int(elevation[i] / BIN_RAD)] = True
    below, above = np.full(bins, -1, dtype=np.int64), np.full(bins, bins, dtype=np.int64)
    number = np.zeros(bins, dtype=np.int64)
    current = used - 1
    for b in range(bins):
        if filled[b]:
            if b == 0 or below[b - 1] < 0 or b - below[b - 1] > EMPTY_BINS:
                current += 1
            number[b], below[b] = current, b
        elif b > 0:
            below[b] = below[b - 1]
    for b in range(bins - 1, -1, -1):
        above[b] = b if filled[b] else (above[b + 1] if b + 1 < bins else bins)
    for i in range(elevation.size):
        at = int(elevation[i] / BIN_RAD)
        is_lower = above[at] == bins or (below[at] >= 0 and at - below[at] <= above[at] - at)
        ring[i] = number[below[at] if is_lower else above[at]]
    return current + 1
