"""The road around one place, from hits of several sweeps whose poses are a little wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy.ndimage import binary_dilation

from detector.arrays import FloatArray, IntArray
from detector.passes.accumulator import PlaceHits
from detector.road.ring_bias import number_rings, ring_offsets
from detector.road.robust import MAD_TO_SD, fit_tukey, quadratic_terms

# Tukey's constant: tight, since a hole's wall must not tilt the road beside it.
CUTOFF_SD = 3.0
FLOOR_SD_M = 0.002
ROUNDS = 3
CELL_M = 0.1
# A cell whose median lies this far off belongs to an obstacle and not to the road.
OBSTACLE_SD = 3.0
OBSTACLE_MIN_M = 0.015
# Pulls a frame's plane towards level: with few hits it must not tilt to fit noise. In hits at 1 m from the centre.
PLANE_RIDGE = 10.0
# Flatter rays than this say nothing of where on the road they ended.
MIN_TANGENT = 1e-3
# Fewer road hits than this leave a frame's own offset unknown.
MIN_FRAME_HITS = 3


@dataclass(frozen=True, slots=True)
class Levelled:
    """Hits (N) freed of what is the pass's and not the road's, in the order of frames.

    Place relative to the window's centre (N, 2), height over the road (N,), frame (N,), and, from each hit to its
    sensor, the level direction (N, 2) and the tangent of the ray's angle to the road (N,). `noise_m` is the standard
    deviation of a hit's height on the road, `road_height_m` the road's own in `odom` at the window's centre.
    """

    xy_m: FloatArray
    height_m: FloatArray
    frame: IntArray
    to_sensor: FloatArray
    tangent: FloatArray
    noise_m: float
    road_height_m: float


@dataclass(frozen=True, slots=True)
class _Window:
    """Hits in the order of frames: place relative to the centre (N, 2), height (N,), where each frame starts (F + 1,),
    the cell of the road (N,) and the number of cells along a side."""

    xy_m: FloatArray
    z_m: FloatArray
    frame: IntArray
    starts: IntArray
    half_size_m: float
    cell: IntArray
    cells: int

    def means(self, values: FloatArray, chosen: np.ndarray) -> tuple[FloatArray, IntArray]:
        """Mean of the chosen hits' values in every cell, and how many there are."""
        count = np.bincount(self.cell[chosen], minlength=self.cells**2)
        total = np.bincount(self.cell[chosen], weights=values[chosen], minlength=self.cells**2)
        return total / np.maximum(count, 1), count


def usable(hits: PlaceHits) -> PlaceHits:
    """The hits that are finite, from finite places, and in the window."""
    finite = np.isfinite(hits.points_m).all(axis=1) & np.isfinite(hits.origins_m[hits.frame]).all(axis=1)
    with np.errstate(invalid="ignore"):
        finite &= (np.abs(hits.points_m[:, :2] - hits.centre_odom_m) <= hits.half_size_m).all(axis=1)
    return hits if finite.all() else replace(hits, points_m=hits.points_m[finite], frame=hits.frame[finite])


def levelled(hits: PlaceHits) -> Levelled:
    """Each hit's place and height over the road, without the frames' offset and tilt and the rings' range bias.

    A robust quadratic through cell means; each frame's median is taken out first (0.1 degree of pitch is 2 to 3 cm at
    15 m), then a small ridge plane per frame and what each ring adds; the surface is refitted without the obstacle's
    cells and their neighbours. A ring that reads too long also puts its hits too far away: they are moved back along
    their rays. Needs at least one hit, all of them `usable`.
    """
    order = np.argsort(hits.frame, kind="stable")
    points, frame = hits.points_m[order], hits.frame[order]
    from_sensor = points - hits.origins_m[frame]
    window = _window(hits, points, frame)
    on_road = np.ones(len(points), dtype=bool)
    shift = np.zeros(len(points))
    shift = _frame_medians(window.starts, window.z_m - _surface(window, shift, on_road))
    on_road = _road_hits(window, window.z_m - shift - _surface(window, shift, on_road))
    ring = number_rings(from_sensor, hits.centre_odom_m - hits.origins_m[:, :2], window.starts, on_road)
    ring_shift = np.zeros(len(points))
    for _ in range(ROUNDS):
        residual = window.z_m - shift - ring_shift - _surface(window, shift + ring_shift, on_road)
        on_road = _road_hits(window, residual)
        shift = shift + _frame_planes(window.starts, window.xy_m, residual, on_road)
        residual = window.z_m - shift - _surface(window, shift + ring_shift, on_road)
        ring_shift = ring_offsets(ring, residual, on_road)
    height = window.z_m - shift - ring_shift - _surface(window, shift + ring_shift, on_road)
    level_m = np.maximum(np.hypot(from_sensor[:, 0], from_sensor[:, 1]), 1e-6)
    direction, tangent = -from_sensor[:, :2] / level_m[:, None], np.maximum(-from_sensor[:, 2] / level_m, MIN_TANGENT)
    return Levelled(
        xy_m=window.xy_m - (ring_shift / tangent)[:, None] * direction,
        height_m=height,
        frame=frame,
        to_sensor=direction,
        tangent=tangent,
        noise_m=MAD_TO_SD * float(np.median(np.abs(height[on_road]))),
        road_height_m=_road_height(hits, points[:, 2] - height),
    )


def _window(hits: PlaceHits, points: FloatArray, frame: IntArray) -> _Window:
    cells = int(np.ceil(2.0 * hits.half_size_m / CELL_M)) + 1
    xy = points[:, :2] - hits.centre_odom_m
    index = np.clip(np.floor((xy + hits.half_size_m) / CELL_M).astype(np.int64), 0, cells - 1)
    return _Window(
        xy_m=xy,
        z_m=points[:, 2] - np.median(points[:, 2]),
        frame=frame,
        starts=np.searchsorted(frame, np.arange(hits.frames + 1)),
        half_size_m=hits.half_size_m,
        cell=index[:, 0] * cells + index[:, 1],
        cells=cells,
    )


def _surface(window: _Window, shift: FloatArray, on_road: np.ndarray) -> FloatArray:
    """Height (N,) at each hit of the robust quadratic through the cells' means of what is left without `shift`."""
    mean, count = window.means(window.z_m - shift, on_road)
    filled = np.flatnonzero(count)
    axis = np.asarray((np.arange(window.cells) + 0.5) * CELL_M / window.half_size_m - 1.0, dtype=np.float64)
    x, y = np.asarray(axis[filled // window.cells]), np.asarray(axis[filled % window.cells])
    # A cell's mean is as sure as its hits are many, but its neighbours share the road's texture.
    weight = np.minimum(count[filled], 4).astype(np.float64)
    coefficients = fit_tukey(quadratic_terms(x, y), mean[filled], weight, CUTOFF_SD, FLOOR_SD_M)
    return np.asarray(_quadratic(window.xy_m, 1.0 / window.half_size_m, coefficients))


@njit(cache=True, nogil=True)
def _quadratic(xy: FloatArray, scale: float, coefficients: FloatArray) -> FloatArray:
    """The quadratic of `quadratic_terms` at places (N, 2) times `scale`."""
    c, height = coefficients, np.empty(len(xy))
    for i in range(len(xy)):
        x, y = xy[i, 0] * scale, xy[i, 1] * scale
        height[i] = c[0] + c[1] * x + c[2] * y + c[3] * x * x + c[4] * x * y + c[5] * y * y
    return height


@njit(cache=True, nogil=True)
def _frame_medians(starts: IntArray, residual: FloatArray) -> FloatArray:
    """The median residual of each hit's frame (N,)."""
    shift = np.zeros(len(residual))
    for frame in range(len(starts) - 1):
        first, last = starts[frame], starts[frame + 1]
        if last - first >= MIN_FRAME_HITS:
            shift[first:last] = np.median(residual[first:last])
    return shift


@njit(cache=True, nogil=True)
def _frame_planes(starts: IntArray, xy: FloatArray, residual: FloatArray, on_road: np.ndarray) -> FloatArray:
    """The robust ridge plane of each hit's frame, at the hit (N,)."""
    shift = np.zeros(len(residual))
    for frame in range(len(starts) - 1):
        first, last = starts[frame], starts[frame + 1]
        road = on_road[first:last]
        if road.sum() < MIN_FRAME_HITS:
            continue
        sd = max(MAD_TO_SD * np.median(np.abs(residual[first:last][road])), FLOOR_SD_M)
        normal, right = np.diag(np.array([1e-9, PLANE_RIDGE + 1e-9, PLANE_RIDGE + 1e-9])), np.zeros(3)
        for i in range(first, last):
            if not on_road[i]:
                continue
            share = max(1.0 - (residual[i] / (2.0 * CUTOFF_SD * sd)) ** 2, 0.0)
            term = np.array([1.0, xy[i, 0], xy[i, 1]])
            for j in range(3):
                right[j] += share * share * term[j] * residual[i]
                for k in range(3):
                    normal[j, k] += share * share * term[j] * term[k]
        plane = np.linalg.solve(normal, right)
        for i in range(first, last):
            shift[i] = plane[0] + plane[1] * xy[i, 0] + plane[2] * xy[i, 1]
    return shift


def _road_hits(window: _Window, residual: FloatArray) -> np.ndarray:
    """Mask (N,) of the hits outside the obstacle's cells and a guard of one cell around them."""
    mean, count = window.means(residual, np.ones(len(residual), dtype=bool))
    sd = MAD_TO_SD * float(np.median(np.abs(residual)))
    limit = max(OBSTACLE_SD * sd, OBSTACLE_MIN_M)
    off_road = (np.abs(mean) * np.sqrt(np.minimum(count, 4)) > limit) & (np.abs(mean) > OBSTACLE_MIN_M)
    guarded = binary_dilation(off_road.reshape(window.cells, window.cells), structure=np.ones((3, 3), dtype=bool))
    on_road = ~guarded.ravel()[window.cell]
    # An obstacle does not cover the window; if it seems to, the fit is bad and everything is used again.
    return np.asarray(on_road if on_road.mean() > 0.3 else np.ones_like(on_road))


def _road_height(hits: PlaceHits, road_m: FloatArray) -> float:
    """Median height in `odom` of the road at the hits in the window's middle third."""
    near = np.abs(hits.points_m[:, :2] - hits.centre_odom_m).max(axis=1) < hits.half_size_m / 3.0
    order = np.argsort(hits.frame, kind="stable")
    return float(np.median(road_m[near[order]] if near.any() else road_m))
