"""From flagged points to clusters, and what surrounds them: the numbers that tell an obstacle from scenery."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.ndimage import label

from detector.corridor import Corridor
from detector.ground import AHEAD_M, REACH_M
from detector.types import FloatArray, IntArray

# Deviation that flags a point, but not the texture of asphalt and patches; what is noise is told by the cluster.
FLAG_SD = 2.5
MIN_DEPTH_M = 0.02
MIN_HEIGHT_M = 0.025
# Deeper is no pothole but a reflection below the road; higher is an overhang.
MAX_DEPTH_M = 0.5
OVERHANG_M = 2.5

CELL_M = 0.25
# Beyond this range rings lie farther apart than a cell: cells grow with range so that neighbours stay neighbours.
COMPRESS_FROM_M = 12.0
MIN_POINTS = 2
MIN_FLAGGED_SHARE = 0.25
# One point counts for at most eight standard deviations.
MAX_POINT_SD = 8.0
# What stands higher is not the road's: a kerb, a wheel, a wall.
ROAD_BAND_M = 0.10
# Behind this the car sees nothing that it did not see nearer before.
BEHIND_M = 12.0
# How far around a cluster the road is looked at: a metre, and along the road what ring spacing (growing with the
# square of range) leaves unseen.
BORDER_REACH_M = 1.0
BORDER_REACH_PER_M2 = 0.008
BORDER_GUARD_M = 0.05
# Room about the strips before, behind and beside a cluster: half a cell, and what a road's fall to its side changes a
# ring's distance by over the reach of a border.
BORDER_SLACK_M = 0.12
CROSS_FALL = 0.03
ROW_M = 1.0


@dataclass(frozen=True, slots=True)
class Deviations:
    """Points of the corridor: coordinates along and across its path, signed residual to the surface and its noise,
    each (N,), in metres, and the sensor's height over the road."""

    along_m: FloatArray
    across_m: FloatArray
    range_m: FloatArray
    residual_m: FloatArray
    noise_m: FloatArray
    sensor_height_m: float

    @property
    def level_range_m(self) -> FloatArray:
        """Range (N,) at which each point's ray crosses the road's level: one value a ring, in a hole or beside it."""
        below_sensor = np.maximum(self.sensor_height_m - self.residual_m, MIN_HEIGHT_M)
        return np.asarray(self.range_m * self.sensor_height_m / below_sensor)

    @property
    def below(self) -> np.ndarray:
        """Mask of points below the road by more than noise."""
        limit = np.maximum(FLAG_SD * self.noise_m, MIN_DEPTH_M)
        return (self.residual_m < -limit) & (self.residual_m > -MAX_DEPTH_M)

    @property
    def above(self) -> np.ndarray:
        """Mask of points above the road by more than noise."""
        limit = np.maximum(FLAG_SD * self.noise_m, MIN_HEIGHT_M)
        return (self.residual_m > limit) & (self.residual_m < OVERHANG_M)


@dataclass(frozen=True, slots=True)
class Cluster:
    """Points (indices into the arrays given) that deviate alike from the road, and how likely they are an obstacle."""

    indices: IntArray
    is_negative: bool
    confidence: float


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What lies in and around each of C clusters, each (C,) but the sides.

    `evidence` is the sum of squared deviations in standard deviations, one point counting for at most eight;
    `relief_m` their mean, `peak_m` the largest. The box is that of the flagged points. `inner` counts the points in it.
    `side_count` (C, 4) and `side_mean_m` (C, 4) are the points before, behind, left and right of the box, and their
    mean deviation with the cluster's sign; `edge_m` is the distance of the box to the corridor's nearer edge.
    """

    count: FloatArray
    evidence: FloatArray
    relief_m: FloatArray
    peak_m: FloatArray
    along_low_m: FloatArray
    along_high_m: FloatArray
    across_low_m: FloatArray
    across_high_m: FloatArray
    inner: FloatArray
    side_count: FloatArray
    side_mean_m: FloatArray
    side_standing: FloatArray
    gap_m: FloatArray
    density_per_m2: FloatArray
    covered: FloatArray
    edge_m: FloatArray

    @property
    def range_m(self) -> FloatArray:
        """Distance (C,) of the box's middle."""
        along = 0.5 * (self.along_low_m + self.along_high_m)
        return np.hypot(along, 0.5 * (self.across_low_m + self.across_high_m))

    @property
    def extent_along_m(self) -> FloatArray:
        """Extent (C,) of the flagged points along the road."""
        return self.along_high_m - self.along_low_m

    @property
    def extent_across_m(self) -> FloatArray:
        """Extent (C,) of the flagged points across the road."""
        return self.across_high_m - self.across_low_m


def group(deviations: Deviations, candidates: np.ndarray, cell_m: float = CELL_M) -> list[IntArray]:
    """Indices of the connected clusters of at least two of the candidate points (mask (N,)).

    Only points in cells of which they are a good part count: among many hits on the road some deviate by chance.
    """
    cell, occupied, taken = _taken(deviations.along_m, deviations.across_m, deviations.range_m, candidates, cell_m)
    if taken.size < MIN_POINTS:
        return []
    components, _ = label(occupied, structure=np.ones((3, 3), dtype=np.int64))
    component = components.ravel()[cell]
    order = np.argsort(component, kind="stable")
    borders = np.flatnonzero(np.diff(component[order])) + 1
    return [members for members in np.split(taken[order], borders) if members.size >= MIN_POINTS]


@njit(cache=True, nogil=True)
def _taken(
    along: FloatArray, across: FloatArray, range_m: FloatArray, candidates: np.ndarray, cell_m: float
) -> tuple[IntArray, np.ndarray, IntArray]:
    """Cell and index of the candidates that are a good part of their cell's points, and the grid of cells that are
    occupied by them or beside them: cells that touch those next but one are one cluster.

    Cells grow with range, so that the grid is never larger than that of the strip.
    """
    shape = (int((BEHIND_M + AHEAD_M) / cell_m) + 4, int(2.0 * REACH_M / cell_m) + 4)
    cell = np.full(len(along), -1, dtype=np.int64)
    hits, marked = np.zeros(shape[0] * shape[1], dtype=np.int32), np.zeros(shape[0] * shape[1], dtype=np.int32)
    for i in range(len(along)):
        if along[i] <= -BEHIND_M:
            continue
        ratio = max(range_m[i] / COMPRESS_FROM_M, 1.0)
        scale = (1.0 + math.log(ratio)) / ratio / cell_m if ratio > 1.0 else 1.0 / cell_m
        row = int(along[i] * scale + BEHIND_M / cell_m) + 1
        column = int(across[i] * scale + REACH_M / cell_m) + 1
        if 0 < row < shape[0] - 1 and 0 < column < shape[1] - 1:
            cell[i] = row * shape[1] + column
            hits[cell[i]] += 1
            marked[cell[i]] += candidates[i]
    taken = np.flatnonzero(candidates)
    kept = np.zeros(len(taken), dtype=np.bool_)
    for n in range(len(taken)):
        c = cell[taken[n]]
        kept[n] = c >= 0 and marked[c] >= MIN_FLAGGED_SHARE * hits[c]
    taken = taken[kept]
    occupied = np.zeros(shape, dtype=np.bool_)
    for n in range(len(taken)):
        middle = divmod(cell[taken[n]], shape[1])
        occupied[middle[0] - 1 : middle[0] + 2, middle[1] - 1 : middle[1] + 2] = True
    return cell[taken], occupied, taken


def surroundings(
    deviations: Deviations, clusters: list[IntArray], is_negative: bool, corridor: Corridor
) -> Surroundings:
    """What lies in and around clusters of one sign."""
    members = np.concatenate(clusters) if clusters else np.empty(0, dtype=np.int64)
    starts = np.concatenate([[0], np.cumsum([len(c) for c in clusters])]).astype(np.int64)
    signed = -deviations.residual_m if is_negative else deviations.residual_m
    order, row_start, first_row = _rows(deviations.along_m)
    own = _own(members, starts, signed, deviations.noise_m, deviations.along_m, deviations.across_m)
    inner, sides, means, standing, context = _around(
        own[:, 4:],
        deviations.level_range_m,
        members,
        starts,
        signed,
        deviations.along_m,
        deviations.across_m,
        CROSS_FALL * BORDER_REACH_M / deviations.sensor_height_m,
        order,
        row_start,
        first_row,
    )
    edge = np.minimum(corridor.left_m - own[:, 7], own[:, 6] - corridor.right_m)
    gap, density, covered = context.T
    count, evidence, relief, peak, low, high, right, left = own.T
    return Surroundings(
        count,
        evidence,
        relief,
        peak,
        low,
        high,
        right,
        left,
        inner,
        sides,
        means,
        standing,
        gap,
        density,
        covered,
        edge,
    )


@njit(cache=True, nogil=True)
def _rows(along: FloatArray) -> tuple[IntArray, IntArray, int]:
    """Order of points by metre of the road, where each metre begins in it, and the first metre."""
    if len(along) == 0:
        return np.empty(0, dtype=np.int64), np.zeros(1, dtype=np.int64), 0
    first, last = int(np.floor(along.min() / ROW_M)), int(np.floor(along.max() / ROW_M))
    starts = np.zeros(last - first + 2, dtype=np.int64)
    for i in range(len(along)):
        starts[int(np.floor(along[i] / ROW_M)) - first + 1] += 1
    starts = np.cumsum(starts)
    filled, order = starts.copy(), np.empty(len(along), dtype=np.int64)
    for i in range(len(along)):
        row = int(np.floor(along[i] / ROW_M)) - first
        order[filled[row]] = i
        filled[row] += 1
    return order, starts, first


@njit(cache=True, nogil=True)
def _own(
    members: IntArray, starts: IntArray, signed: FloatArray, noise: FloatArray, along: FloatArray, across: FloatArray
) -> FloatArray:
    """Count, evidence, mean and largest deviation, and box of each cluster (C, 8)."""
    own = np.zeros((len(starts) - 1, 8))
    for c in range(len(starts) - 1):
        box = np.array([np.inf, -np.inf, np.inf, -np.inf])
        for n in range(starts[c], starts[c + 1]):
            i = members[n]
            own[c, 1] += min(signed[i] / noise[i], MAX_POINT_SD) ** 2
            own[c, 2] += signed[i]
            own[c, 3] = max(own[c, 3], signed[i])
            box[0], box[1] = min(box[0], along[i]), max(box[1], along[i])
            box[2], box[3] = min(box[2], across[i]), max(box[3], across[i])
        own[c, 0] = starts[c + 1] - starts[c]
        own[c, 2] /= own[c, 0]
        own[c, 4:] = box
    return own


@njit(cache=True, nogil=True)
def _around(
    boxes: FloatArray,
    level: FloatArray,
    members: IntArray,
    starts: IntArray,
    signed: FloatArray,
    along: FloatArray,
    across: FloatArray,
    ring_slope: float,
    order: IntArray,
    row_start: IntArray,
    first_row: int,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Points inside each box; number and mean deviation of the road's and number of other points on its four sides;
    gap in the road along it, density of points around it, and share of its width with road before it (C, 3).

    Left and right only the cluster's own rings count, by the range at which they cross the road's level: what they show
    there too is their own error, or a wave of the road.
    """
    clusters = len(starts) - 1
    inner = np.zeros(clusters)
    sides, means, standing = np.zeros((clusters, 4)), np.zeros((clusters, 4)), np.zeros((clusters, 4))
    context = np.zeros((clusters, 3))
    flagged = np.zeros(len(along), dtype=np.bool_)
    for c in range(clusters):
        nearest, farthest = np.inf, 0.0
        for n in range(starts[c], starts[c + 1]):
            i = members[n]
            flagged[i] = True
            nearest, farthest = min(nearest, level[i]), max(farthest, level[i])
        low, high, right, left = boxes[c]
        square = (0.5 * (low + high)) ** 2 + (0.5 * (left + right)) ** 2
        reach = BORDER_REACH_M + BORDER_REACH_PER_M2 * square
        slack = BORDER_GUARD_M + ring_slope * farthest
        nearest, farthest = nearest - slack, farthest + slack
        ahead = low + high > 0.0
        road_low, road_high = low - reach, high + reach
        before_right, before_left = left, right
        first = max(int(np.floor((low - reach) / ROW_M)) - first_row, 0)
        last = min(int(np.floor((high + reach) / ROW_M)) - first_row + 1, len(row_start) - 1)
        for n in range(row_start[min(first, len(row_start) - 1)], row_start[max(last, 0)]):
            i = order[n]
            s, t = along[i], across[i]
            if flagged[i] or (low <= s <= high and right <= t <= left):
                inner[c] += 1.0
                continue
            within_across = right - BORDER_SLACK_M < t < left + BORDER_SLACK_M
            if within_across and low - reach < s < low - BORDER_GUARD_M:
                side = 0 if ahead else 1
            elif within_across and high + BORDER_GUARD_M < s < high + reach:
                side = 1 if ahead else 0
            elif nearest < level[i] < farthest and left + BORDER_GUARD_M < t < left + BORDER_REACH_M:
                side = 2
            elif nearest < level[i] < farthest and right - BORDER_REACH_M < t < right - BORDER_GUARD_M:
                side = 3
            else:
                continue
            if abs(signed[i]) > ROAD_BAND_M:
                standing[c, side] += 1.0
                continue
            sides[c, side] += 1.0
            means[c, side] += signed[i]
            if side == 0:
                before_right, before_left = min(before_right, t), max(before_left, t)
            if within_across and s < low:
                road_low = max(road_low, s)
            elif within_across and s > high:
                road_high = min(road_high, s)
        for n in range(starts[c], starts[c + 1]):
            flagged[members[n]] = False
        for k in range(4):
            if sides[c, k] > 0.0:
                means[c, k] /= sides[c, k]
        across_area = (left - right + 2.0 * BORDER_SLACK_M) * 2.0 * (reach - BORDER_GUARD_M)
        along_area = (farthest - nearest) * 2.0 * (BORDER_REACH_M - BORDER_GUARD_M)
        context[c, 0] = road_high - road_low
        context[c, 1] = sides[c].sum() / (across_area + along_area)
        overlap = min(before_left, left) - max(before_right, right)
        context[c, 2] = max(overlap, 0.0) / max(left - right, BORDER_SLACK_M)
    return inner, sides, means, standing, context
