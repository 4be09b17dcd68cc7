"""The points of a sweep that may be ground, in road coordinates, and the long profile of the road among them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from detector.arrays import FloatArray, IntArray
from detector.road.robust import fit_tukey

BEHIND_M = 20.0
AHEAD_M = 45.0
# A dual carriageway's half, and what a curve that tightens ahead adds to it.
REACH_M = 16.0
# Grades change by up to 12 % within the range of a sweep, and a braking car pitches by a degree.
BAND_M = 0.35
BAND_GRADE = 0.10
# Along the road: heights are taken from its middle, under which the car itself drives.
BIN_M = 1.0
MIDDLE_M = 1.2
# A bin's road lies within this of the line of those before it, and a little more for each metre between them.
STEP_BAND_M = 0.1
STEP_BAND_GRADE = 0.03
SLOPE_GAIN = 0.3
MIN_BINS = 4
MIN_BIN_HITS = 3
BIN_SD_M = 0.02
# A pavement lies one kerb and its own fall above the road's edge.
CROSS_BAND_M = 0.4
# What is higher hangs over the road.
STANDING_M = 2.5


@dataclass(frozen=True, slots=True)
class GroundPoints:
    """Points (G,) that may be ground or stand on it: index into the sweep, distance along and offset across the path
    (left positive), and height over the road's long profile, in metres; `profile` (3,) are its coefficients of 1, s
    and s^2, s the distance along."""

    index: IntArray
    along_m: FloatArray
    across_m: FloatArray
    height_m: FloatArray
    profile: FloatArray


def near_ground(points_m: FloatArray, sensor_height_m: float, curvature_per_m: float) -> GroundPoints:
    """Points (N, 3) of the frame `sensor` near the ground, by a profile followed outwards from below the car."""
    index, along, across, height = _candidates(points_m, sensor_height_m, curvature_per_m)
    profile = _profile(along, across, height)
    kept = _flatten(profile, index, along, across, height)
    return GroundPoints(index[:kept], along[:kept], across[:kept], height[:kept], profile)


@njit(cache=True, nogil=True)
def _flatten(profile: FloatArray, index: IntArray, along: FloatArray, across: FloatArray, height: FloatArray) -> int:
    """Takes the profile out of the heights and moves what is not below any road to the front: how many those are."""
    kept = 0
    for i in range(len(height)):
        over = height[i] - (profile[0] + along[i] * (profile[1] + along[i] * profile[2]))
        if -CROSS_BAND_M < over < STANDING_M:
            index[kept], along[kept], across[kept], height[kept] = index[i], along[i], across[i], over
            kept += 1
    return kept


def height_over_profile(
    points_m: FloatArray, sensor_height_m: float, curvature_per_m: float, profile: FloatArray
) -> FloatArray:
    """Height (N,) of points (N, 3) of the frame `sensor` over a profile (3,), level beyond where it was followed."""
    return np.asarray(_height_over_profile(points_m, sensor_height_m, curvature_per_m, profile))


@njit(cache=True, nogil=True)
def _height_over_profile(points: FloatArray, sensor_height: float, curvature: float, profile: FloatArray) -> FloatArray:
    height = np.empty(len(points))
    for i in range(len(points)):
        s, _ = road_coordinate(points[i, 0], points[i, 1], curvature)
        s = min(max(s, -BEHIND_M), AHEAD_M)
        height[i] = points[i, 2] + sensor_height - (profile[0] + s * (profile[1] + s * profile[2]))
    return height


def from_road_coordinates(along_m: FloatArray, across_m: FloatArray, curvature_per_m: float) -> FloatArray:
    """Positions (N, 2) at distances along and offsets across (N,) a circle: the inverse of `road_coordinates`."""
    if abs(curvature_per_m) < 1e-9:
        return np.stack([along_m, across_m], axis=1)
    angle, radius = along_m * curvature_per_m, 1.0 / curvature_per_m - across_m
    return np.stack([radius * np.sin(angle), 1.0 / curvature_per_m - radius * np.cos(angle)], axis=1)


def road_coordinates(points_m: FloatArray, curvature_per_m: float) -> tuple[FloatArray, FloatArray]:
    """Distance along and offset across (left positive), (N,) each, of a circle through the origin along x."""
    along, across = _road_coordinates(points_m, curvature_per_m)
    return along, across


@njit(cache=True, nogil=True)
def road_coordinate(x: float, y: float, curvature: float) -> tuple[float, float]:
    """Distance along and offset across of one point of `road_coordinates`.

    With centre (0, 1/c), the offset 1/c - distance to the centre is written so that c = 0 needs no special case.
    """
    if abs(curvature) < 1e-9:
        return x, y
    bend = curvature * (x * x + y * y)
    q = max(1.0 - curvature * (2.0 * y - bend), 0.0)
    return math.atan2(curvature * x, 1.0 - curvature * y) / curvature, (2.0 * y - bend) / (1.0 + math.sqrt(q))


@njit(cache=True, nogil=True)
def _road_coordinates(points: FloatArray, curvature: float) -> tuple[FloatArray, FloatArray]:
    along, across = np.empty(len(points)), np.empty(len(points))
    for i in range(len(points)):
        along[i], across[i] = road_coordinate(points[i, 0], points[i, 1], curvature)
    return along, across


@njit(cache=True, nogil=True)
def _candidates(
    points: FloatArray, sensor_height: float, curvature: float
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Index, road coordinates and height over the level ground below the car, of what may be ground or stand on it."""
    count = len(points)
    index = np.empty(count, dtype=np.int64)
    along, across, height = np.empty(count), np.empty(count), np.empty(count)
    kept = 0
    reach = max(AHEAD_M, BEHIND_M)
    for i in range(count):
        x, y, z = float(points[i, 0]), float(points[i, 1]), float(points[i, 2]) + sensor_height
        band = BAND_M + BAND_GRADE * (abs(x) + abs(y))
        if z < -band or z > band + STANDING_M or abs(x) > reach or abs(y) > reach:
            continue
        s, t = road_coordinate(x, y, curvature)
        if -BEHIND_M < s < AHEAD_M and abs(t) < REACH_M:
            index[kept], along[kept], across[kept], height[kept] = i, s, t, z
            kept += 1
    return index[:kept], along[:kept], across[:kept], height[:kept]


def _profile(along_m: FloatArray, across_m: FloatArray, height_m: FloatArray) -> FloatArray:
    """Coefficients (3,) of 1, s, s^2 of the road's height along its middle; level where too little of it is seen."""
    followed = _follow(*_by_bin(along_m, across_m, height_m))
    known = np.flatnonzero(np.isfinite(followed))
    if known.size < MIN_BINS:
        return np.zeros(3)
    s = (known + 0.5) * BIN_M - BEHIND_M
    terms = np.stack([np.ones_like(s), s / AHEAD_M, np.square(s / AHEAD_M)], axis=1)
    coefficients = fit_tukey(terms, followed[known], np.ones(known.size), cutoff_sd=4.685, floor_sd=BIN_SD_M)
    return np.asarray(coefficients / np.array([1.0, AHEAD_M, AHEAD_M**2]))


@njit(cache=True, nogil=True)
def _by_bin(along: FloatArray, across: FloatArray, height: FloatArray) -> tuple[FloatArray, IntArray]:
    """Heights of the road's middle bin by bin, and where each bin begins in them, with the end of the last."""
    bins = int((BEHIND_M + AHEAD_M) / BIN_M)
    start = np.zeros(bins + 1, dtype=np.int64)
    for i in range(len(along)):
        b = int((along[i] + BEHIND_M) / BIN_M)
        if abs(across[i]) < MIDDLE_M and b < bins:
            start[b + 1] += 1
    start = np.cumsum(start)
    filled, heights = start.copy(), np.empty(start[bins])
    for i in range(len(along)):
        b = int((along[i] + BEHIND_M) / BIN_M)
        if abs(across[i]) < MIDDLE_M and b < bins:
            heights[filled[b]] = height[i]
            filled[b] += 1
    return heights, start


@njit(cache=True, nogil=True)
def _follow(height: FloatArray, start: IntArray) -> FloatArray:
    """Median height of each bin (NaN: none), taken among what lies near the line of the bins before it."""
    bins = len(start) - 1
    followed = np.full(bins, np.nan)
    origin = int(BEHIND_M / BIN_M)
    for direction in (1, -1):
        level, slope, last = 0.0, 0.0, 0
        for step in range(bins):
            b = origin + direction * step if direction > 0 else origin - 1 - step
            if b < 0 or b >= bins:
                break
            mine = height[start[b] : start[b + 1]]
            band = STEP_BAND_M + STEP_BAND_GRADE * BIN_M * (step - last)
            expected = level + slope * (step - last)
            if last == 0:
                # Nothing is followed yet: the lowest of what may be ground, on whatever slope the car looks at.
                wide = mine[np.abs(mine) < STEP_BAND_M + BAND_GRADE * BIN_M * step]
                if len(wide) < MIN_BIN_HITS:
                    continue
                expected = np.sort(wide)[len(wide) // 10]
                band = STEP_BAND_M
            near = mine[np.abs(mine - expected) < band]
            if len(near) < MIN_BIN_HITS:
                continue
            median = np.median(near)
            if last == 0:
                slope = median / (step + 0.5)
            else:
                slope += SLOPE_GAIN * ((median - level) / (step - last) - slope)
            level, last = median, step
            followed[b] = median
    return followed
