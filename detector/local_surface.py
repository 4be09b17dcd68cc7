"""The road around one place, from hits of several sweeps whose poses are a little wrong."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_dilation

from detector.accumulator import PlaceHits
from detector.robust import MAD_TO_SD, fit_tukey, quadratic_terms, tukey_weight
from detector.types import FloatArray

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
# Fewer road hits than this leave a frame's own offset unknown.
MIN_FRAME_HITS = 3


def local_residuals(hits: PlaceHits) -> FloatArray:
    """Height (N,) of each hit over the road around the place, without the frames' own offset and tilt.

    A robust quadratic; each frame's median is taken out first (0.1 degree of pitch is 2 to 3 cm at 15 m), then a small
    ridge plane per frame; the surface is refitted without the obstacle's cells and their neighbours.
    """
    x, y = (hits.points_m[:, :2] - hits.centre_odom_m).T
    terms = quadratic_terms(x / hits.half_size_m, y / hits.half_size_m)
    z = hits.points_m[:, 2] - np.median(hits.points_m[:, 2])
    on_road = np.ones(len(z), dtype=bool)
    shift = _frame_medians(hits, z - terms @ _fit(terms, z, on_road), on_road)
    for _ in range(ROUNDS):
        residual = z - shift - terms @ _fit(terms, z - shift, on_road)
        on_road = _road_hits(hits, residual)
        shift = shift + _frame_planes(hits, residual, on_road)
    return z - shift - terms @ _fit(terms, z - shift, on_road)


def _fit(terms: FloatArray, z: FloatArray, on_road: np.ndarray) -> FloatArray:
    return fit_tukey(terms[on_road], z[on_road], np.ones(int(on_road.sum())), CUTOFF_SD, FLOOR_SD_M)


def _frame_medians(hits: PlaceHits, residual: FloatArray, on_road: np.ndarray) -> FloatArray:
    """The median residual of each hit's frame (N,)."""
    shift = np.zeros(len(residual))
    for k in range(hits.frames):
        mine = hits.frame == k
        if (mine & on_road).sum() >= MIN_FRAME_HITS:
            shift[mine] = np.median(residual[mine & on_road])
    return shift


def _frame_planes(hits: PlaceHits, residual: FloatArray, on_road: np.ndarray) -> FloatArray:
    """The robust ridge plane of each hit's frame, at the hit (N,)."""
    x, y = (hits.points_m[:, :2] - hits.centre_odom_m).T
    terms = np.stack([np.ones_like(x), x, y], axis=1)
    ridge = np.diag([0.0, PLANE_RIDGE, PLANE_RIDGE])
    shift = np.zeros(len(residual))
    for k in range(hits.frames):
        mine = hits.frame == k
        road = mine & on_road
        if road.sum() < MIN_FRAME_HITS:
            continue
        sd = max(MAD_TO_SD * float(np.median(np.abs(residual[road]))), FLOOR_SD_M)
        weighted = terms[road] * tukey_weight(residual[road], 2.0 * CUTOFF_SD * sd)[:, None]
        normal = weighted.T @ terms[road] + ridge + 1e-9 * np.eye(3)
        shift[mine] = terms[mine] @ np.linalg.solve(normal, weighted.T @ residual[road])
    return shift


def _road_hits(hits: PlaceHits, residual: FloatArray) -> np.ndarray:
    """Mask (N,) of the hits outside the obstacle's cells and a guard of one cell around them."""
    cells = int(np.ceil(2.0 * hits.half_size_m / CELL_M)) + 1
    index = np.floor((hits.points_m[:, :2] - hits.centre_odom_m + hits.half_size_m) / CELL_M).astype(np.int64)
    cell = np.clip(index[:, 0], 0, cells - 1) * cells + np.clip(index[:, 1], 0, cells - 1)
    count = np.bincount(cell, minlength=cells * cells)
    mean = np.bincount(cell, weights=residual, minlength=cells * cells) / np.maximum(count, 1)
    sd = MAD_TO_SD * float(np.median(np.abs(residual)))
    limit = max(OBSTACLE_SD * sd, OBSTACLE_MIN_M)
    off_road = (np.abs(mean) * np.sqrt(np.minimum(count, 4)) > limit).reshape(cells, cells)
    off_road &= (np.abs(mean) > OBSTACLE_MIN_M).reshape(cells, cells)
    guarded = binary_dilation(off_road, structure=np.ones((3, 3), dtype=bool))
    on_road = ~guarded.ravel()[cell]
    # An obstacle does not cover the window; if it seems to, the fit is bad and everything is used again.
    return on_road if on_road.mean() > 0.3 else np.ones_like(on_road)
