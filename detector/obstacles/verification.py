"""Which clusters are obstacles on the road: neither scenery, nor a shadow's edge, nor a ring's own error."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from detector.arrays import FloatArray, IntArray
from detector.obstacles.clusters import Cluster, cores, group
from detector.obstacles.confidence import HOLE_WEIGHTS, MIN_CONFIDENCE, RISE_WEIGHTS, confidence
from detector.obstacles.surroundings import Surroundings, surroundings
from detector.road.corridor import Corridor
from detector.road.deviations import Deviations

# Two points at 4.2 standard deviations each, or four at 3.
MIN_EVIDENCE = 36.0
# Beyond these ranges a crest of the road cannot be told from a low rise, a wave of it from a hole, nor a thing from the
# end of what is seen.
MAX_LOW_RANGE_M = 22.0
MAX_HOLE_RANGE_M = 32.0
MAX_RANGE_M = 42.0
# The far edge of the neighbouring lane: what lies beyond is nobody's who drives here, and its road hardly seen.
MAX_OFFSET_M = 6.0
# Obstacles on the road are shorter than a car and lower than its bonnet; only a low hump lies across the road.
MAX_EXTENT_M = 2.5
MAX_HEIGHT_M = 0.6
HUMP_HEIGHT_M = 0.15
HUMP_MIN_WIDTH_M = 1.0
EDGE_MARGIN_M = 0.05
# A stripe along one ring, longer than the gap to the rings beside it is wide, is that ring's own error.
MAX_STRIPE_RATIO = 2.2
# A hump may be as wide as a 3.5 m lane; the shortest made are 0.4 m long, their ends lost in noise.
MAX_HUMP_RATIO = 10.0
# Where the car hides the road before a hole, its own edge is seen and not a rim.
MIN_COVERED = 0.6
NARROW_M = 0.2
# Hits over the density of the road around them: what is hit of the smallest hole that is looked for.
MIN_HOLE_AREA_M2 = 0.02
# Hits over those a metre of the same rings has beside it: less is a crack, or one hit astray on each ring.
MIN_WIDTH_M = 0.06
# A dip as narrow and as shallow as this is the texture of a road.
TEXTURE_WIDTH_M, TEXTURE_DEPTH_M = 0.12, 0.03
# Around an obstacle the road is less than this share of it off the surface; more, and the surface is off.
MAX_BESIDE_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class Candidates:
    """Clusters of one sign, what lies around them, and which of them (mask) pass for obstacles."""

    groups: list[IntArray]
    around: Surroundings
    is_negative: bool
    plausible: np.ndarray


def candidates_of(deviations: Deviations, flagged: np.ndarray, is_negative: bool, corridor: Corridor) -> Candidates:
    """Clusters of flagged points (mask (N,)) of one sign."""
    groups = group(deviations, flagged)
    if is_negative:
        groups = groups + cores(deviations, groups)
    around = surroundings(deviations, groups, is_negative, corridor)
    return Candidates(groups, around, is_negative, plausible(around, is_negative))


def candidates_of_sweep(
    deviations: Deviations, flagged: np.ndarray, is_negative: bool, corridor: Corridor
) -> Candidates:
    """Clusters of flagged points (mask (N,)) of one sweep; those that are no texture or stray hits pass."""
    candidates = candidates_of(deviations, flagged, is_negative, corridor)
    around = candidates.around
    passes = candidates.plausible & (around.count >= MIN_WIDTH_M * around.beside_per_m)
    return replace(candidates, plausible=passes & ~_is_texture(around) if is_negative else passes)


def _is_texture(around: Surroundings) -> np.ndarray:
    extent = np.maximum(around.extent_along_m, around.extent_across_m)
    return np.asarray((extent < TEXTURE_WIDTH_M) & (around.peak_m < TEXTURE_DEPTH_M))


@dataclass(frozen=True, slots=True)
class Found:
    """Likely obstacles of a sweep, holes first, and the indices of all points that deviate together, low and high."""

    clusters: list[Cluster]
    low: IntArray
    high: IntArray


def find_clusters(deviations: Deviations, candidates: np.ndarray, corridor: Corridor) -> Found:
    """Clusters among the candidate points (mask (N,)) of a sweep."""
    low = candidates_of_sweep(deviations, deviations.below & candidates, True, corridor)
    high = candidates_of_sweep(deviations, deviations.above & candidates, False, corridor)
    clusters = likely(low, HOLE_WEIGHTS) + likely(high, RISE_WEIGHTS)
    return Found(clusters, _members(low), _members(high))


def _members(candidates: Candidates) -> IntArray:
    return np.concatenate(candidates.groups) if candidates.groups else np.empty(0, dtype=np.int64)


def likely(candidates: Candidates, weights: FloatArray, least: float = MIN_CONFIDENCE) -> list[Cluster]:
    """The plausible clusters that a model believes in at least so much; of those that share points the surest."""
    if not candidates.groups:
        return []
    sure = confidence(candidates.around, weights)
    chosen = np.flatnonzero(candidates.plausible & (sure >= least))
    taken: set[int] = set()
    clusters = []
    for c in chosen[np.argsort(-sure[chosen], kind="stable")]:
        members = set(candidates.groups[c].tolist())
        if taken.isdisjoint(members):
            clusters.append((c, Cluster(candidates.groups[c], candidates.is_negative, float(sure[c]))))
            taken |= members
    return [cluster for _, cluster in sorted(clusters, key=lambda pair: int(pair[0]))]


def plausible(around: Surroundings, is_negative: bool) -> np.ndarray:
    """Mask (C,) of the clusters that pass for obstacles."""
    offset = np.abs(0.5 * (around.across_low_m + around.across_high_m))
    enough = (around.evidence >= MIN_EVIDENCE) & (offset < MAX_OFFSET_M)
    return np.asarray(enough & (_is_hole(around) if is_negative else _is_rise(around)))


def _is_hole(around: Surroundings) -> np.ndarray:
    """A hole is closed: road is seen on all four sides, as high as the surface, and before it nearer than what stands
    there, behind which a shadow begins and not a hole."""
    seen = (around.side_count > 0).all(axis=1)
    small = np.maximum(around.extent_along_m, around.extent_across_m) < MAX_EXTENT_M
    level = around.side_mean_m.max(axis=1) < MAX_BESIDE_SHARE * around.relief_m
    unshadowed = around.shadow_m < 0.0
    inside = (around.edge_m > EDGE_MARGIN_M) & (around.range_m < MAX_HOLE_RANGE_M)
    covered = around.count > MIN_HOLE_AREA_M2 * around.density_per_m2
    closed = (around.covered > MIN_COVERED) | (around.extent_across_m < NARROW_M)
    return np.asarray(
        seen & small & level & unshadowed & inside & covered & closed & ~_is_stripe(around, MAX_STRIPE_RATIO)
    )


def _is_stripe(around: Surroundings, ratio: float) -> np.ndarray:
    return np.asarray(around.extent_across_m > ratio * around.gap_m)


def _is_rise(around: Surroundings) -> np.ndarray:
    """Road is seen before a rise, or on both sides where the car hides it before; but for a hump from edge to edge also
    beside it; behind only what is low."""
    share = around.side_mean_m / around.relief_m[:, None]
    before, behind, left, right = (share[:, k] < MAX_BESIDE_SHARE for k in range(4))
    seen = around.side_count > 0
    low = around.peak_m < HUMP_HEIGHT_M
    across = around.extent_across_m
    is_hump = low & (across > HUMP_MIN_WIDTH_M) & (across > around.extent_along_m)
    small = (around.extent_along_m < MAX_EXTENT_M) & (around.peak_m < MAX_HEIGHT_M)
    alone = (across < MAX_EXTENT_M) & (around.edge_m > EDGE_MARGIN_M) & ((seen[:, 2] & left) | (seen[:, 3] & right))
    near = around.range_m < np.where(low, MAX_LOW_RANGE_M, MAX_RANGE_M)
    sound = seen[:, 1] & behind & ~_is_stripe(around, MAX_HUMP_RATIO)
    open_before = (seen[:, 0] & before) | (~seen[:, 0] & seen[:, 2] & left & seen[:, 3] & right)
    return np.asarray(small & near & open_before & (is_hump | alone) & (~low | sound))
