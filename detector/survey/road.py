"""The road of a survey: its level, a smooth surface that holes do not bend, and the noise about it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from detector.arrays import FloatArray, IntArray
from detector.road.robust import MAD_TO_SD, quadratic_terms, robust_sd, tukey_weight
from detector.survey.grid import Grid, make_grid, measure_spacing, smooth

# Means of coarse cells that a robust fit takes at most.
MAX_FIT_CELLS = 4000
TUKEY_SD = 3.0
PLANES = 300
ITERATIONS = 10
# A normal distribution loses one value in eighty to this.
CLIP_SD = 2.5
# Clouds without noise have a spread of zero: deviations below this share of the spacing are nothing.
FLOOR_SHARE = 0.01
# Noise is what a Gaussian mean of this many cells removes.
FINE_CELLS = 1.5


@dataclass(frozen=True, slots=True)
class LevelFrame:
    """Rotation `level_from_input` (3, 3) that lays the road's plane flat, about the point `origin_m` (3,)."""

    level_from_input: FloatArray
    origin_m: FloatArray

    def to_level(self, points_m: FloatArray) -> FloatArray:
        """Points (N, 3) with the plane at z = 0."""
        return np.asarray((points_m - self.origin_m) @ self.level_from_input.T)

    def to_input(self, points_m: FloatArray) -> FloatArray:
        """The inverse of `to_level`."""
        return np.asarray(points_m @ self.level_from_input + self.origin_m)


@dataclass(frozen=True, slots=True)
class Relief:
    """Depth below the road as a map (R, C) and for each point (N,) at `xy_m` (N, 2), positive down; `count` a cell.

    `noise_m` is the standard deviation of single points, `wave_m` that of the road's own roughness, means of cells.
    """

    grid: Grid
    xy_m: FloatArray
    cells: IntArray
    count: FloatArray
    depth_map_m: FloatArray
    depth_m: FloatArray
    noise_m: float
    wave_m: float

    def upside_down(self) -> Relief:
        """The same with heights for depths."""
        return replace(self, depth_map_m=-self.depth_map_m, depth_m=-self.depth_m)


def level(points_m: FloatArray) -> LevelFrame:
    """Frame of the robust plane through points (N, 3), up where z is up."""
    low, high = points_m.min(axis=0), points_m.max(axis=0)
    origin = np.array([*(0.5 * (low + high)[:2]), float(np.median(points_m[:, 2]))])
    local = points_m - origin
    places, heights, weight = _coarse_means(local[:, :2], local[:, 2])
    scale = max(float((high - low)[:2].max()), 1e-12)
    offset, slope_x, slope_y = _upper_plane(places / scale, heights, weight, 1e-6 * scale)
    normal = np.array([-slope_x / scale, -slope_y / scale, 1.0])
    normal /= np.linalg.norm(normal)
    return LevelFrame(_rotation_to_z(normal), origin + np.array([0.0, 0.0, offset]))


def relief(points_m: FloatArray) -> Relief | None:
    """Depth of the points (N, 3) of a levelled survey below its smooth road; None where the points span no area."""
    xy, z = points_m[:, :2], points_m[:, 2]
    spacing = measure_spacing(xy)
    if not spacing > 0.0:
        return None
    grid = make_grid(xy, spacing)
    cells = grid.cells(xy)
    count = grid.count(cells)
    places, heights, weight = _coarse_means(xy, z)
    scale = max(float(np.abs(xy).max()), 1e-12)
    floor = FLOOR_SHARE * grid.cell_m
    coefficients = _quadratic(places / scale, heights, weight, floor)
    depth = _terms(xy, scale) @ coefficients - z
    depth_map = grid.mean(cells, depth, count)
    fine, _ = smooth(depth_map, (count > 0).astype(np.float64), FINE_CELLS)
    noise = max(robust_sd(depth - grid.sample(fine, xy)), floor)
    wave = max(_clipped_sd(fine[count > 0]), floor)
    return Relief(grid, xy, cells, count, depth_map, depth, noise, wave)


def _clipped_sd(values: FloatArray) -> float:
    """Standard deviation of most values, however many a hole adds on one side."""
    kept = values
    for _ in range(ITERATIONS):
        middle, sd = float(np.median(kept)), robust_sd(kept)
        kept = values[np.abs(values - middle) <= CLIP_SD * sd]
    return robust_sd(kept)


def _terms(xy: FloatArray, scale: float) -> FloatArray:
    return quadratic_terms(xy[:, 0] / scale, xy[:, 1] / scale)


def _upper_plane(xy: FloatArray, z: FloatArray, weight: FloatArray, floor: float) -> FloatArray:
    """Offset and slopes (3,) of the plane that most of the places (C, 2) lie near: a hole may cover four in ten.

    Least median of squares (Rousseeuw, 1984) over planes through three places, then Tukey's weights about the best.
    """
    terms = np.column_stack([np.ones(len(xy)), xy])
    rng = np.random.default_rng(0)
    best, spread = np.zeros(3), np.inf
    for triple in rng.integers(0, len(xy), (PLANES, 3)):
        try:
            plane = np.linalg.solve(terms[triple], z[triple])
        except np.linalg.LinAlgError:
            continue
        median = float(np.median(np.abs(z - terms @ plane)))
        if median < spread:
            best, spread = plane, median
    return _reweighted(terms, z, weight, best, floor)


def _quadratic(xy: FloatArray, z: FloatArray, weight: FloatArray, floor: float) -> FloatArray:
    """Coefficients (6,) of the quadratic about the level plane."""
    return _reweighted(quadratic_terms(xy[:, 0], xy[:, 1]), z, weight, np.zeros(6), floor)


def _reweighted(terms: FloatArray, z: FloatArray, weight: FloatArray, start: FloatArray, floor: float) -> FloatArray:
    """Tukey's estimate of `terms` (C, T) from a start that is already robust."""
    coefficients = start
    for _ in range(ITERATIONS):
        residual = z - terms @ coefficients
        spread = max(MAD_TO_SD * float(np.median(np.abs(residual))), floor)
        w = weight * tukey_weight(residual, TUKEY_SD * spread)
        coefficients = np.asarray(np.linalg.lstsq(terms * np.sqrt(w)[:, None], z * np.sqrt(w), rcond=1e-9)[0])
    return coefficients


def _coarse_means(xy: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Places (C, 2), mean heights (C,) and weights (C,) of at most some thousand coarse cells."""
    span = np.maximum(xy.max(axis=0) - xy.min(axis=0), 1e-12)
    grid = make_grid(xy, max(math.sqrt(float(span[0] * span[1]) / MAX_FIT_CELLS), float(span.max()) / MAX_FIT_CELLS))
    cells = grid.cells(xy)
    count = np.bincount(cells)
    occupied = np.flatnonzero(count)
    count = count[occupied]
    mean = [np.bincount(cells, weights=v)[occupied] / count for v in (xy[:, 0], xy[:, 1], z)]
    # An area counts as one, however densely a wall in it was measured.
    weight = np.minimum(count / np.median(count), 1.0)
    return np.stack(mean[:2], axis=1), mean[2], weight


def _rotation_to_z(normal: FloatArray) -> FloatArray:
    """Smallest rotation (3, 3) that turns a unit normal to +z."""
    x, y, z = normal
    denominator = 1.0 / (1.0 + z)
    return np.array(
        [
            [1.0 - x * x * denominator, -x * y * denominator, -x],
            [-x * y * denominator, 1.0 - y * y * denominator, -y],
            [x, y, z],
        ]
    )
