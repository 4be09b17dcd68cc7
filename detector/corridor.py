"""The road ahead as a strip along the path that the steering gives, bounded by kerbs where there are any."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detector.types import FloatArray

BEHIND_M = 20.0
AHEAD_M = 40.0

# Half of a two-lane urban road; taken where no kerb is found.
DEFAULT_HALF_WIDTH_M = 3.5
# A kerb nearer than half a car's width, or farther than a three-lane carriageway, is something else.
NEAREST_EDGE_M = 1.25
FARTHEST_EDGE_M = 8.0
# Kerbs are 10 to 15 cm high; over 0.5 m a 5 % cross fall makes 2.5 cm.
KERB_STEP_M = 0.06
CHUNK_M = 2.0
LATERAL_CELL_M = 0.25
KERB_REACH_M = (-10.0, 24.0)
# Steps found in at least this share of the chunks that were seen make an edge; a single thing on the road does not.
EDGE_SUPPORT = 0.4
EDGE_SPREAD_CELLS = 2
MIN_EDGE_CHUNKS = 3


@dataclass(frozen=True, slots=True)
class Corridor:
    """Strip of road about a circular path through the sensor: `right_m` < 0 < `left_m` are offsets across it."""

    curvature_per_m: float
    left_m: float
    right_m: float

    def contains(self, along_m: FloatArray, across_m: FloatArray, margin_m: float = 0.0) -> np.ndarray:
        """Mask of road coordinates inside the strip widened by `margin_m`."""
        within = (across_m < self.left_m + margin_m) & (across_m > self.right_m - margin_m)
        return within & (along_m > -BEHIND_M) & (along_m < AHEAD_M)


def road_coordinates(points_m: FloatArray, curvature_per_m: float) -> tuple[FloatArray, FloatArray]:
    """Distance along and offset across (left positive) a circle of `curvature_per_m` through the origin along x.

    With centre (0, 1/c), the offset 1/c - distance to the centre is written so that c = 0 needs no special case.
    """
    x, y = points_m[:, 0], points_m[:, 1]
    c = curvature_per_m
    if abs(c) < 1e-9:
        return x, y
    q = np.maximum(1.0 - 2.0 * c * y + c * c * (x * x + y * y), 0.0)
    across = (2.0 * y - c * (x * x + y * y)) / (1.0 + np.sqrt(q))
    return np.arctan2(c * x, 1.0 - c * y) / c, across


def find_corridor(along_m: FloatArray, across_m: FloatArray, height_m: FloatArray, curvature_per_m: float) -> Corridor:
    """Corridor from points near the ground; `height_m` is above the flat ground below the sensor.

    An edge is where the mean height rises by a kerb's step in most chunks of the road; without one the default width
    is taken.
    """
    heights = _lateral_profile(along_m, across_m, height_m)
    middle = heights.shape[1] // 2
    left = _edge_offset(heights[:, middle:])
    right = _edge_offset(heights[:, middle - 1 :: -1])
    return Corridor(curvature_per_m, left, -right)


def _lateral_profile(along_m: FloatArray, across_m: FloatArray, height_m: FloatArray) -> FloatArray:
    """Mean height (chunk, lateral cell), NaN where nothing was hit."""
    rows = int((KERB_REACH_M[1] - KERB_REACH_M[0]) / CHUNK_M)
    columns = 2 * int((FARTHEST_EDGE_M + 1.0) / LATERAL_CELL_M)
    row = np.floor((along_m - KERB_REACH_M[0]) / CHUNK_M).astype(np.int64)
    column = np.floor(across_m / LATERAL_CELL_M).astype(np.int64) + columns // 2
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    cell = row[inside] * columns + column[inside]
    count = np.bincount(cell, minlength=rows * columns)
    total = np.bincount(cell, weights=height_m[inside], minlength=rows * columns)
    mean = np.full(rows * columns, np.nan)
    mean[count > 0] = total[count > 0] / count[count > 0]
    return mean.reshape(rows, columns)


def _edge_offset(heights: FloatArray) -> float:
    """Offset of the first rise going outward (columns) that most chunks (rows) seen there share."""
    rise = heights[:, 2:] - heights[:, :-2]
    steps = rise > KERB_STEP_M
    steps[:, : int(NEAREST_EDGE_M / LATERAL_CELL_M) - 1] = False
    found = np.flatnonzero(steps.any(axis=1))
    if found.size < MIN_EDGE_CHUNKS:
        return DEFAULT_HALF_WIDTH_M
    first = np.argmax(steps[found], axis=1)
    column = int(np.median(first))
    agreeing = int((np.abs(first - column) <= EDGE_SPREAD_CELLS).sum())
    seen = int(np.isfinite(rise[:, max(column - 1, 0) : column + 2]).any(axis=1).sum())
    if agreeing < max(MIN_EDGE_CHUNKS, EDGE_SUPPORT * seen):
        return DEFAULT_HALF_WIDTH_M
    # The rise from cell i to i + 2 lies at the outer border of cell i + 1, or a little inside it.
    return float(min((column + 1.5) * LATERAL_CELL_M, FARTHEST_EDGE_M))
