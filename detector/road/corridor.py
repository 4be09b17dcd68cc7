"""The road ahead as a strip: it begins along the path that the steering gives, and follows its kerbs from there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from detector.arrays import FloatArray
from detector.road.ground import AHEAD_M, BEHIND_M, CROSS_BAND_M, REACH_M, GroundPoints, road_coordinates

__all__ = ["AHEAD_M", "BEHIND_M", "Corridor", "find_corridor", "road_coordinates"]

# Half of a two-lane urban road; taken where no kerb is found.
DEFAULT_HALF_WIDTH_M = 3.5
# A kerb nearer than half a car's width, or farther than a carriageway of four lanes, is something else.
NEAREST_EDGE_M = 1.0
FARTHEST_EDGE_M = 13.0
# Kerbs are 8 to 15 cm high; over 0.5 m a 5 % cross fall makes 2.5 cm.
KERB_STEP_M = 0.055
CHUNK_M = 2.0
# Cars and walls bound the road like kerbs; that many hits are none of a branch or of rain.
MIN_STANDING_HITS = 3
LATERAL_CELL_M = 0.25
# Where the steering's circle still is the road, to a car's width, when a curve begins or ends ahead.
NEAR_M = 12.0
# Steps found in at least this share of the near chunks that were seen make an edge; a single thing does not.
EDGE_SUPPORT = 0.4
MIN_EDGE_CHUNKS = 3
# What a step one cell beside the edge counts.
BESIDE_WEIGHT = 0.6
# An edge ahead is looked for this far on both sides of where the edges before it lead.
SEARCH_M = 0.9
# Deviations of the path from the steering's circle: heading (s), curvature (s^2) and its change (s^3), at 20 m.
PATH_SCALE_M = 20.0
# Standard deviations of those three there: 1 degree of heading, 0.01 / m of curvature, a clothoid of 20 m to 50 m.
PATH_PRIOR_M = np.array([0.4, 1.5, 1.5])
# What is tried of the first two near the car.
HEADINGS_M = np.array([0.0, -0.3, 0.3, -0.6, 0.6])
BENDS_M = np.array([0.0, -0.7, 0.7, -1.4, 1.4])
EDGE_SD_M = 0.2
FIT_CUTOFF_M = 0.7


@dataclass(frozen=True, slots=True)
class Corridor:
    """Strip of road about a path through the sensor: `right_m` < 0 < `left_m` are offsets across it.

    The path is the circle of `curvature_per_m` plus `path_m` (3,), the offsets that its terms in s, s^2 and s^3 have
    20 m ahead. `profile` (3,) are the coefficients of 1, s and s^2 of the road's height over the level ground below
    the car.
    """

    curvature_per_m: float
    left_m: float
    right_m: float
    path_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    profile: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def offset_m(self, along_m: FloatArray) -> FloatArray:
        """Offset (N,) of the path from the steering's circle at distances (N,)."""
        s = along_m / PATH_SCALE_M
        return np.asarray(s * (self.path_m[0] + s * (self.path_m[1] + s * self.path_m[2])))

    def height_m(self, along_m: FloatArray) -> FloatArray:
        """Height (N,) of the long profile at distances (N,), level beyond where it was followed."""
        s = np.clip(along_m, -BEHIND_M, AHEAD_M)
        return np.asarray(self.profile[0] + s * (self.profile[1] + s * self.profile[2]))

    def contains(self, along_m: FloatArray, across_m: FloatArray, margin_m: float = 0.0) -> np.ndarray:
        """Mask of distances along and offsets across the path inside the strip widened by `margin_m`."""
        within = (across_m < self.left_m + margin_m) & (across_m > self.right_m - margin_m)
        return within & (along_m > -BEHIND_M) & (along_m < AHEAD_M)


def find_corridor(ground: GroundPoints, curvature_per_m: float) -> Corridor:
    """Corridor from points near the ground.

    An edge is where the mean height rises by a kerb's step in most chunks of the near road; without one the default
    width is taken. From there its steps are followed chunk by chunk, which bends the path.
    """
    rise = _rises(ground)
    left, right, heading, bend = _near_edges(rise > KERB_STEP_M, np.isfinite(rise))
    path = _follow(rise, left, right, np.array([heading, bend, 0.0]))
    half = DEFAULT_HALF_WIDTH_M
    return Corridor(
        curvature_per_m,
        half if np.isnan(left) else left,
        -half if np.isnan(right) else -right,
        (float(path[0]), float(path[1]), float(path[2])),
        (float(ground.profile[0]), float(ground.profile[1]), float(ground.profile[2])),
    )


REACH_CELLS = int(REACH_M / LATERAL_CELL_M)


def _rises(ground: GroundPoints) -> FloatArray:
    """Outward rise (chunk, lateral cell) of the mean height over two cells, at the outer border of each cell.

    NaN where nothing was hit. Columns run from right to left; the middle lies between REACH_CELLS - 1 and REACH_CELLS.
    """
    rows = int((AHEAD_M + BEHIND_M) / CHUNK_M)
    mean = _cell_heights(ground.along_m, ground.across_m, ground.height_m, rows, 2 * REACH_CELLS)
    rise: FloatArray = np.full(mean.shape, np.nan)
    rise[:, REACH_CELLS:-1] = mean[:, REACH_CELLS + 1 :] - mean[:, REACH_CELLS - 1 : -2]
    rise[:, 1:REACH_CELLS] = mean[:, : REACH_CELLS - 1] - mean[:, 2 : REACH_CELLS + 1]
    return rise


@njit(cache=True, nogil=True)
def _cell_heights(along: FloatArray, across: FloatArray, height: FloatArray, rows: int, columns: int) -> FloatArray:
    """Mean height of what may be ground; of cells where something stands, its least height; NaN where nothing is."""
    total, count = np.zeros((rows, columns)), np.zeros((rows, columns))
    standing = np.zeros((rows, columns), dtype=np.int64)
    for i in range(len(along)):
        row = int((along[i] + BEHIND_M) / CHUNK_M)
        column = int((across[i] + REACH_M) / LATERAL_CELL_M)
        if row < 0 or row >= rows or column < 0 or column >= columns:
            continue
        if height[i] >= CROSS_BAND_M:
            standing[row, column] += 1
        else:
            total[row, column] += height[i]
            count[row, column] += 1.0
    for row in range(rows):
        for column in range(columns):
            if standing[row, column] >= MIN_STANDING_HITS:
                total[row, column] = CROSS_BAND_M
            elif count[row, column] > 0.0:
                total[row, column] /= count[row, column]
            else:
                total[row, column] = np.nan
    return np.asarray(total)


@njit(cache=True, nogil=True)
def _near_edges(steps: np.ndarray, seen: np.ndarray) -> tuple[float, float, float, float]:
    """Offsets of the left and the right edge (NaN: none), and the path's offsets at 20 m by heading and by curvature.

    The path is tried with some headings and curvatures; that counts on which most near chunks show their edges alike.
    """
    best, found = -1.0, (np.nan, np.nan, 0.0, 0.0)
    for heading in HEADINGS_M:
        for bend in BENDS_M:
            left, on_left = _edge(steps, seen, 1, heading, bend)
            right, on_right = _edge(steps, seen, -1, heading, bend)
            # A chunk is worth bending the path by as much as its prior's standard deviation.
            cost = (heading / PATH_PRIOR_M[0]) ** 2 + (bend / PATH_PRIOR_M[1]) ** 2
            score = on_left + on_right - cost
            if score > best:
                best, found = score, (left, right, heading, bend)
    return found


@njit(cache=True, nogil=True)
def _edge(steps: np.ndarray, seen: np.ndarray, side: int, heading: float, bend: float) -> tuple[float, float]:
    """Offset of the nearest edge on one side that enough of the near chunks seen there share, and their number."""
    first, last = int((BEHIND_M - NEAR_M) / CHUNK_M), int((BEHIND_M + NEAR_M) / CHUNK_M)
    nearest, most, enough_to = np.nan, 0.0, 0.0
    for k in range(int(NEAREST_EDGE_M / LATERAL_CELL_M), int(FARTHEST_EDGE_M / LATERAL_CELL_M)):
        offset = (k + 0.5) * LATERAL_CELL_M
        shared, looked = 0.0, 0
        for row in range(first, last):
            s = ((row + 0.5) * CHUNK_M - BEHIND_M) / PATH_SCALE_M
            column = int((side * offset + s * (heading + s * bend) + REACH_M) / LATERAL_CELL_M)
            if column < 2 or column >= steps.shape[1] - 2:
                continue
            if steps[row, column]:
                shared += 1.0
            elif steps[row, column - 1] or steps[row, column + 1]:
                shared += BESIDE_WEIGHT
            looked += seen[row, column - 1] or seen[row, column] or seen[row, column + 1]
        if enough_to > 0.0 and offset > enough_to:
            break
        if shared > most and shared >= max(MIN_EDGE_CHUNKS, EDGE_SUPPORT * looked):
            enough_to = offset + 2.0 * LATERAL_CELL_M if enough_to == 0.0 else enough_to
            nearest, most = offset, shared
    return nearest, most


@njit(cache=True, nogil=True)
def _follow(rise: FloatArray, left: float, right: float, start: FloatArray) -> FloatArray:
    """Path's offsets at 20 m (3,) from the steps found along both edges, going away from the car."""
    path = start.copy()
    normal = np.diag(1.0 / PATH_PRIOR_M**2)
    moment = normal @ start
    origin = int(BEHIND_M / CHUNK_M)
    rows = len(rise)
    # Near to far, ahead and behind in turn, so that what is sure bends the path first.
    for step in range(rows):
        for row in (origin + step, origin - 1 - step):
            if row < 0 or row >= rows:
                continue
            s = ((row + 0.5) * CHUNK_M - BEHIND_M) / PATH_SCALE_M
            expected = s * (path[0] + s * (path[1] + s * path[2]))
            for side, edge in ((1, left), (-1, right)):
                if np.isnan(edge):
                    continue
                offset = _nearest_step(rise[row], expected + side * edge, side)
                if np.isnan(offset):
                    continue
                deviation = offset - side * edge
                weight = max(1.0 - ((deviation - expected) / FIT_CUTOFF_M) ** 2, 0.0) ** 2 / EDGE_SD_M**2
                terms = np.array([s, s * s, s**3])
                normal += weight * np.outer(terms, terms)
                moment += weight * deviation * terms
        path[:] = np.linalg.solve(normal, moment)
    return path


@njit(cache=True, nogil=True)
def _nearest_step(rise: FloatArray, expected: float, side: int) -> float:
    """Offset of the step nearest to where it is expected, within the search; NaN where there is none."""
    best, nearest = np.nan, SEARCH_M
    for column in range(1, len(rise) - 1):
        # A step lies at the outer border of its cell's inner half.
        offset = (column + 0.5 - REACH_CELLS) * LATERAL_CELL_M
        if side * offset > NEAREST_EDGE_M * 0.5 and rise[column] > KERB_STEP_M and abs(offset - expected) < nearest:
            nearest, best = abs(offset - expected), offset
    return best
