"""What lies in and around clusters: the numbers that tell an obstacle from scenery."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from detector.arrays import FloatArray, IntArray
from detector.obstacles.clusters import MAX_POINT_SD
from detector.road.corridor import Corridor
from detector.road.deviations import ROW_M, Deviations

# What stands higher is not the road's: a kerb, a wheel, a wall.
ROAD_BAND_M = 0.10
# How far around a cluster the road is looked at: a metre, and along the road what ring spacing (growing with the
# square of range) leaves unseen.
BORDER_REACH_M = 1.0
BORDER_REACH_PER_M2 = 0.008
BORDER_GUARD_M = 0.05
# Room about the strips before, behind and beside a cluster: half a cell, and what a road's fall to its side changes a
# ring's distance by over the reach of a border.
BORDER_SLACK_M = 0.12
CROSS_FALL = 0.03


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What lies in and around each of C clusters, each (C,) but the sides.

    `evidence` is the sum of squared deviations in standard deviations, one point counting for at most eight;
    `relief_m` their mean, `peak_m` the largest. The box is that of the flagged points. `inner` counts the points in it.
    `side_count` (C, 4) and `side_mean_m` (C, 4) are the points before, behind, left and right of the box, and their
    mean deviation with the cluster's sign; `shadow_m` is by how much what stands before the box is nearer than the road
    before it (negative: road is seen between), `edge_m` the distance of the box to the corridor's nearer edge.
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
    gap_m: FloatArray
    density_per_m2: FloatArray
    covered: FloatArray
    shadow_m: FloatArray
    edge_m: FloatArray

    @property
    def range_m(self) -> FloatArray:
        """Distance (C,) of the box's middle."""
        along = 0.5 * (self.along_low_m + self.along_high_m)
        return np.hypot(along, 0.5 * (self.across_low_m + self.across_high_m))

    @property
    def beside_per_m(self) -> FloatArray:
        """Points (C,) of the same rings in a metre of the road beside."""
        return np.asarray(self.side_count[:, 2:].sum(axis=1) / (2.0 * (BORDER_REACH_M - BORDER_GUARD_M)))

    @property
    def extent_along_m(self) -> FloatArray:
        """Extent (C,) of the flagged points along the road."""
        return self.along_high_m - self.along_low_m

    @property
    def extent_across_m(self) -> FloatArray:
        """Extent (C,) of the flagged points across the road."""
        return self.across_high_m - self.across_low_m


def surroundings(
    deviations: Deviations, clusters: list[IntArray], is_negative: bool, corridor: Corridor
) -> Surroundings:
    """What lies in and around clusters of one sign."""
    members = np.concatenate(clusters) if clusters else np.empty(0, dtype=np.int64)
    starts = np.concatenate([[0], np.cumsum([len(c) for c in clusters])]).astype(np.int64)
    signed = -deviations.residual_m if is_negative else deviations.residual_m
    by_metre = deviations.by_metre
    own = _own(members, starts, signed, deviations.noise_m, deviations.along_m, deviations.across_m)
    inner, sides, means, context = _around(
        own[:, 4:].copy(),
        deviations.level_range_m,
        members,
        starts,
        signed,
        deviations.along_m,
        deviations.across_m,
        CROSS_FALL * BORDER_REACH_M / deviations.sensor_height_m,
        by_metre.order,
        by_metre.start,
        by_metre.first,
    )
    edge = np.minimum(corridor.left_m - own[:, 7], own[:, 6] - corridor.right_m)
    gap, density, covered, shadow = context.T
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
        gap,
        density,
        covered,
        shadow,
        edge,
    )


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
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Points inside each box; number and mean deviation of the road's on its four sides; gap in the road along it,
    density of points around it, share of its width with road before it, and its depth in a shadow (C, 4).

    Left and right only the cluster's own rings count, by the range at which they cross the road's level: what they show
    there too is their own error, or a wave of the road.
    """
    clusters = len(starts) - 1
    inner = np.zeros(clusters)
    sides, means = np.zeros((clusters, 4)), np.zeros((clusters, 4))
    context = np.zeros((clusters, 4))
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
        road_before, standing_before = np.inf, np.inf
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
                if side == 0:
                    standing_before = min(standing_before, max(low - s, s - high))
                continue
            sides[c, side] += 1.0
            means[c, side] += signed[i]
            if side == 0:
                road_before = min(road_before, max(low - s, s - high))
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
        if standing_before < np.inf:
            context[c, 3] = road_before - standing_before
        else:
            context[c, 3] = -reach
    return inner, sides, means, context
