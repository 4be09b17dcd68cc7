"""From flagged points to clusters that are too much to be noise, and too small to be part of the scenery."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, label

from detector.corridor import Corridor
from detector.types import FloatArray, IntArray

# Deviation that flags a point: three standard deviations, but not the texture of asphalt and patches.
FLAG_SD = 3.0
MIN_DEPTH_M = 0.02
MIN_HEIGHT_M = 0.03
# Deeper is no pothole but a reflection below the road; higher is an overhang.
MAX_DEPTH_M = 0.5
OVERHANG_M = 2.5

CELL_M = 0.25
# Beyond this range rings lie farther apart than a cell: cells grow with range so that neighbours stay neighbours.
COMPRESS_FROM_M = 12.0
MIN_POINTS = 2
# Chi-square-like evidence: two points at six standard deviations; one point counts for at most eight.
MIN_EVIDENCE = 36.0
MAX_POINT_SD = 8.0
# Obstacles on the road are lower than a car's bonnet, and shorter than a car.
MAX_HEIGHT_M = 0.5
MAX_EXTENT_M = 2.5
# Kerbs, cars and walls reach over the edge; only a low hump lies across the road from edge to edge.
EDGE_MARGIN_M = 0.2
HUMP_HEIGHT_M = 0.15
HUMP_MIN_WIDTH_M = 1.0
# Two hits at the road's edge are the kerb; two beyond what is well seen may be anything.
MIN_HUMP_HITS = 4
# A hole is verified by the road seen before and behind it: at most this far, plus what ring spacing (growing with the
# square of range) leaves unseen.
BORDER_REACH_M = 1.0
BORDER_REACH_PER_M2 = 0.008
AZIMUTH_MARGIN_RAD = 0.01
# A stripe along one ring, far longer than the gaps to the rings beside it are wide, is that ring's calibration.
MAX_STRIPE_RATIO = 3.0
# A hump may be as wide as a 3.5 m lane; the shortest made are 0.4 m long.
MAX_HUMP_RATIO = 9.0
# This many hits within this width sample it densely enough to say that it is a stone's gap and no pothole.
DENSE_HITS = 3
MIN_HOLE_WIDTH_M = 0.12
# Of the hits between a hole's nearest and farthest the flagged ones must be most.
MIN_INNER_SHARE = 0.5
# A ray reaches a hole's floor only past its near rim; what the depth's noise and the rim's shape may hide of that.
RIM_SLACK_M = 0.25
# A hole is closed: its own rings show the road on both sides within this reach, where no shadow hides it.
SIDE_REACH_M = 1.0
# Roads fall 2 to 2.5 % to their sides: so much a ring's range changes over that reach, and a little more.
CROSS_FALL = 0.03
# Beyond this range a few hits decide: no hole is told from a wave of the road, and only what stands high from a hump.
MAX_HOLE_RANGE_M = 25.0
MIN_FAR_HEIGHT_M = 0.15
# Behind this the car sees nothing that it did not see nearer before.
BEHIND_M = 12.0
# Of the points in a cluster's cells the flagged ones must be many; scattered outliers are few among many.
MIN_FLAGGED_SHARE = 0.3


@dataclass(frozen=True, slots=True)
class Cluster:
    """Points (indices into the arrays given) that deviate alike from the road, and the evidence for it."""

    indices: IntArray
    is_negative: bool
    evidence: float


@dataclass(frozen=True, slots=True)
class Deviations:
    """Points of the corridor: road coordinates, signed residual to the surface and its noise, each (N,), in metres,
    and the sensor's height over the road."""

    along_m: FloatArray
    across_m: FloatArray
    range_m: FloatArray
    residual_m: FloatArray
    noise_m: FloatArray
    sensor_height_m: float

    @property
    def azimuth_rad(self) -> FloatArray:
        """Direction (N,) of each point about the sensor, along the road's curve."""
        return np.arctan2(self.across_m, self.along_m)

    @property
    def level_range_m(self) -> FloatArray:
        """Range (N,) at which each point's ray crosses the road's level: one value a ring, in a hole or beside it."""
        return self.range_m * self.sensor_height_m / np.maximum(self.sensor_height_m - self.residual_m, MIN_HEIGHT_M)

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


def find_clusters(deviations: Deviations, candidates: np.ndarray, corridor: Corridor) -> list[Cluster]:
    """Clusters among the candidate points (mask (N,)) that pass as obstacles on the road, holes first."""
    clusters: list[Cluster] = []
    candidates = candidates & (deviations.along_m > -BEHIND_M)
    for is_negative, flagged in ((True, deviations.below), (False, deviations.above)):
        cell_of, share = _rasterise(deviations, flagged & candidates)
        for indices in _groups(cell_of, np.flatnonzero(flagged & candidates)):
            cluster = _verify(deviations, indices, is_negative, float(share[indices].mean()), corridor)
            if cluster is not None:
                clusters.append(cluster)
    return clusters


def _rasterise(deviations: Deviations, flagged: np.ndarray) -> tuple[IntArray, FloatArray]:
    """Connected component of each flagged point, and the flagged share of each point's cell (N,)."""
    scale = _compression(deviations.range_m)
    row = np.floor(deviations.along_m * scale / CELL_M).astype(np.int64)
    column = np.floor(deviations.across_m * scale / CELL_M).astype(np.int64)
    if row.size == 0:
        return np.empty(0, dtype=np.int64), np.empty(0)
    row, column = row - row.min() + 1, column - column.min() + 1
    shape = (int(row.max()) + 2, int(column.max()) + 2)
    cell = row * shape[1] + column
    hits = np.bincount(cell, minlength=shape[0] * shape[1])
    marked = np.bincount(cell[flagged], minlength=hits.size)
    occupied = binary_dilation((marked > 0).reshape(shape), structure=np.ones((3, 3), dtype=bool))
    components, _ = label(occupied, structure=np.ones((3, 3), dtype=np.int64))
    share = marked / np.maximum(hits, 1)
    return components.ravel()[cell[flagged]], share[cell]


def _compression(range_m: FloatArray) -> FloatArray:
    """Factor that makes cells grow in proportion to range beyond the limit."""
    ratio = np.maximum(range_m / COMPRESS_FROM_M, 1.0)
    return (1.0 + np.log(ratio)) / ratio


def _groups(component_of: IntArray, indices: IntArray) -> list[IntArray]:
    order = np.argsort(component_of, kind="stable")
    borders = np.flatnonzero(np.diff(component_of[order])) + 1
    return [group for group in np.split(indices[order], borders) if group.size >= MIN_POINTS]


def _verify(
    deviations: Deviations, indices: IntArray, is_negative: bool, flagged_share: float, corridor: Corridor
) -> Cluster | None:
    residual = deviations.residual_m[indices]
    noise = deviations.noise_m[indices]
    evidence = _evidence(residual, noise)
    if evidence < MIN_EVIDENCE or flagged_share < MIN_FLAGGED_SHARE:
        return None
    if _is_scenery(deviations.along_m[indices], deviations.across_m[indices], residual, is_negative, corridor):
        return None
    offset = _azimuth_about(deviations, indices)
    if is_negative and not _has_road_around(deviations, indices, offset):
        return None
    is_low = residual.max() < HUMP_HEIGHT_M
    if is_low and (_is_stripe(deviations, indices, offset) or not _stands_out(deviations, indices, offset)):
        return None
    return Cluster(indices, is_negative, evidence)


def _evidence(residual_m: FloatArray, noise_m: FloatArray) -> float:
    return float(np.sum(np.square(np.minimum(np.abs(residual_m) / noise_m, MAX_POINT_SD))))


def _is_scenery(
    along: FloatArray, across: FloatArray, residual: FloatArray, is_negative: bool, corridor: Corridor
) -> bool:
    """Whether a cluster is a kerb, a car, a wall or the road's edge rather than an obstacle on the road."""
    extent_along, extent_across = np.ptp(along), np.ptp(across)
    at_edge = across.max() > corridor.left_m - EDGE_MARGIN_M or across.min() < corridor.right_m + EDGE_MARGIN_M
    if is_negative:
        return bool(at_edge or max(extent_along, extent_across) > MAX_EXTENT_M)
    height = residual.max()
    few = along.size < MIN_HUMP_HITS
    is_hump = (
        height < HUMP_HEIGHT_M
        and not (few and at_edge)
        and extent_across >= HUMP_MIN_WIDTH_M
        and extent_across > extent_along
    )
    if along.min() > MAX_HOLE_RANGE_M and (few or height < MIN_FAR_HEIGHT_M):
        return True
    if is_hump:
        return bool(extent_along > MAX_EXTENT_M)
    return bool(at_edge or height > MAX_HEIGHT_M or max(extent_along, extent_across) > MAX_EXTENT_M)


def _has_road_around(deviations: Deviations, indices: IntArray, offset_rad: FloatArray) -> bool:
    """Whether the rays show the road before and behind a hole, with room for its depth.

    A ray that ends at depth d crossed the road's level d / tan(its angle) before; no road can be hit between.
    """
    range_m = deviations.range_m[indices]
    nearest, farthest = float(range_m.min()), float(range_m.max())
    beside, width = _sector(deviations, indices, offset_rad)
    if farthest > MAX_HOLE_RANGE_M or (width < MIN_HOLE_WIDTH_M and indices.size >= DENSE_HITS):
        return False
    inner = beside & (deviations.range_m >= nearest) & (deviations.range_m <= farthest)
    if indices.size < MIN_INNER_SHARE * inner.sum():
        return False
    before, behind = _road_borders(deviations, beside, nearest, farthest)
    depth = np.maximum(-deviations.residual_m[indices] - FLAG_SD * deviations.noise_m[indices], 0.0)
    entry = float(np.median(range_m - depth * range_m / deviations.sensor_height_m))
    reach = BORDER_REACH_M + BORDER_REACH_PER_M2 * farthest**2
    return max(nearest - before, behind - farthest) < reach and entry > before - RIM_SLACK_M


def _is_stripe(deviations: Deviations, indices: IntArray, offset_rad: FloatArray) -> bool:
    """Whether a cluster lies along one ring, with the road on both sides too near for anything of that length."""
    range_m = deviations.range_m[indices]
    beside, width = _sector(deviations, indices, offset_rad)
    before, behind = _road_borders(deviations, beside, float(range_m.min()), float(range_m.max()))
    is_negative = bool(deviations.residual_m[indices[0]] < 0.0)
    return width > (MAX_STRIPE_RATIO if is_negative else MAX_HUMP_RATIO) * (behind - before)


def _sector(deviations: Deviations, indices: IntArray, offset_rad: FloatArray) -> tuple[np.ndarray, float]:
    """Mask (N,) of all points in the directions of a cluster, and the cluster's width across them."""
    low, high = float(offset_rad[indices].min()), float(offset_rad[indices].max())
    beside = (offset_rad >= low - AZIMUTH_MARGIN_RAD) & (offset_rad <= high + AZIMUTH_MARGIN_RAD)
    return beside, (high - low) * float(deviations.range_m[indices].min())


def _road_borders(
    deviations: Deviations, beside: np.ndarray, nearest_m: float, farthest_m: float
) -> tuple[float, float]:
    """Ranges of the last road before and the first road behind a stretch; infinitely far where none is seen."""
    road = deviations.range_m[beside & ~deviations.below & ~deviations.above]
    return float(road[road < nearest_m].max(initial=-np.inf)), float(road[road > farthest_m].min(initial=np.inf))


def _stands_out(deviations: Deviations, indices: IntArray, offset_rad: FloatArray) -> bool:
    """Whether a hole or a low rise stays one against what its own rings show left and right of it.

    What they show there too is their calibration or a wave of the road. A hole is closed: where nothing is seen
    beside it an occluder's shadow begins, and the surface was fitted to nothing there. A hump may fill the road.
    """
    left, right = _sides(deviations, indices, offset_rad)
    is_negative = bool(deviations.residual_m[indices[0]] < 0.0)
    sign = -1.0 if is_negative else 1.0
    beside = [sign * float(np.median(side)) for side in (left, right) if side.size]
    if is_negative and len(beside) < 2:
        return False
    common = max(max(beside) if is_negative else min(beside, default=0.0), 0.0)
    relief, noise = sign * deviations.residual_m[indices] - common, deviations.noise_m[indices]
    standing = relief > np.maximum(FLAG_SD * noise, MIN_DEPTH_M if is_negative else MIN_HEIGHT_M)
    return bool(standing.sum() >= MIN_POINTS) and _evidence(relief[standing], noise[standing]) >= MIN_EVIDENCE


def _sides(deviations: Deviations, indices: IntArray, offset_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Residuals of the road that the rings of a cluster show left and right of it."""
    level_range = deviations.level_range_m
    low, high = offset_rad[indices].min(), offset_rad[indices].max()
    reach = SIDE_REACH_M / float(deviations.range_m[indices].min())
    nearest, farthest = float(level_range[indices].min()), float(level_range[indices].max())
    slack = CROSS_FALL * SIDE_REACH_M * farthest / deviations.sensor_height_m
    same_rings = (level_range > nearest - slack) & (level_range < farthest + slack)
    road = same_rings & (deviations.residual_m < HUMP_HEIGHT_M)
    left = (offset_rad > high) & (offset_rad < high + reach)
    right = (offset_rad < low) & (offset_rad > low - reach)
    return deviations.residual_m[road & left], deviations.residual_m[road & right]


def _azimuth_about(deviations: Deviations, indices: IntArray) -> FloatArray:
    """Azimuth (N,) of all points about the first of `indices`, in [-pi, pi)."""
    azimuth = deviations.azimuth_rad
    return np.asarray(np.remainder(azimuth - azimuth[indices[0]] + np.pi, 2.0 * np.pi) - np.pi)
