"""The outline of a hole or a rise on the maps of a pass, and again without each group of sweeps."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt

from detector.arrays import FloatArray, IntArray
from detector.obstacles.descriptor import fold_yaw, moment_box, polygon_moments
from detector.passes.height_map import CELL_M, Grid, Map, contour_around, region_of
from detector.passes.pass_maps import Samples, evidence_maps, relief_map, relief_maps, smooth, smoothing_m, without
from detector.types import ObstacleKind

# Near the road's level, where a wall begins: the share of the depth and the standard deviations of a hit, whichever is
# more, at which what lies below is the hole.
LEVEL_SHARE = 0.05
LEVEL_SDS = 1.5
# Hits below the level farther than this from what is surely below the road are noise, or a sweep that is off.
GUARD_M = 0.1
# One ray leaves many air samples and only one solid one.
AIR_WEIGHT = 0.65
# Halfway up is unbiased for upright sides.
RISE_LEVEL_SHARE = 0.5
# The flank of a rise is half a wave (a sinusoidal hump, TRL report 377): a quarter and half of the height lie a third
# and half of the way up from its foot, so the foot lies twice their distance out from the first.
FOOT_SHARES, FOOT_ONWARD = (0.25, 0.5), 2.0
# Relief below this is texture and noise of the road.
MIN_RELIEF_M = 0.02
MIN_SIDE_M = 0.1
# What is deeper than this share of the depth is the obstacle's core, which its outline must hold.
CORE_SHARE = 0.3
# Greatest depth: so much of the hits is shallower, and noise adds so many of its standard deviations to that.
EXTREME_SHARE, EXTREME_SDS = 0.98, 1.3
# Seen evenly, that quantile is 0.93 to 0.99 of the deepest place of real potholes (gypsum scans), 0.90 to 0.93 of
# simulated ones, 1 of a level floor; rays see what is deep less often: 0.91 of that in passes. Tops of
# bumps: 0.9; things are flat.
SEEN_SHARE = 0.87
# In the shadow behind a rise the road counts with this share of the density of hits on it.
SHADOW_SHARE = 0.12
# Only hits speak for a rise, no air: a pass from one side leaves 5 cm between them.
RISE_SIGMA_M = 0.04
# How far from the middle of the window the obstacle may begin.
SEED_RADIUS_M = 0.8
# A bump's flanks rise by less than one in two; the sides of what lies on the road are steeper, even smoothed.
DEBRIS_SLOPE = 0.5
# No bump of the road is higher than a speed hump may be.
BUMP_MAX_HEIGHT_M = 0.2
# Halfway up, a rise of the road is wider than a brick is long.
BUMP_MIN_WIDTH_M = 0.22

Box = tuple[float, float, float]
"""Length, width and yaw in [0, pi)."""


@dataclass(frozen=True, slots=True)
class Outline:
    """Outline (K, 2) relative to the window's centre, the box around it, the greatest depth or height inside, the map
    (G, G) of that and the cells (G, G) inside."""

    kind: ObstacleKind
    polygon_m: FloatArray
    centroid_m: FloatArray
    box: Box
    relief_m: float
    relief_map: Map
    inside: np.ndarray


@dataclass(frozen=True, slots=True)
class _Maps:
    """What all outlines of a pass are drawn from: samples and their cells, the map (G, G) of depth or height, a hit's
    noise, and the smoothing."""

    samples: Samples
    grid: Grid
    cell: tuple[IntArray, IntArray]
    relief: Map
    noise_m: float
    sigma_m: float


@dataclass(frozen=True, slots=True)
class _Core:
    """The region (G, G) that is surely off the road, its usual depth or height, and what is deeper than a share."""

    region: np.ndarray
    relief_m: float
    inside: np.ndarray


def outlines(samples: Samples, grid: Grid, is_negative: bool, noise_m: float) -> Iterator[Outline | None]:
    """The outline from all groups of sweeps, then without each in turn; nothing if there is no obstacle."""
    relief = relief_map(samples.xy_m, samples.relief_m, grid)
    sigma_m = smoothing_m(len(samples.relief_m), grid)
    maps = _Maps(samples, grid, grid.cell_of(samples.xy_m), relief, noise_m, sigma_m)
    core = _core(maps)
    if core is not None:
        drawing: _Hole | _Rise = _Hole(maps, core) if is_negative else _Rise(maps, core)
        for group in (None, *range(samples.groups)):
            yield drawing.draw(group)


def _core(maps: _Maps) -> _Core | None:
    whole = maps.relief
    region = region_of(whole, maps.grid, MIN_RELIEF_M, SEED_RADIUS_M)
    if region is None:
        return None
    values = whole[region]
    relief_m = float(np.quantile(values[values > 0.4 * values.max()], 0.8))
    return _Core(region, relief_m, region & (whole > CORE_SHARE * relief_m)) if relief_m >= MIN_RELIEF_M else None


class _Hole:
    """Near the road's level rays passed through the hole, or hit the road: where both weigh the same is its outline."""

    def __init__(self, maps: _Maps, core: _Core) -> None:
        self._maps, self._core = maps, core
        level_m = max(LEVEL_SHARE * core.relief_m, LEVEL_SDS * maps.noise_m)
        about = distance_transform_edt(~core.region) * CELL_M < GUARD_M
        below = (maps.samples.relief_m > level_m) & about[maps.cell]
        solid, free = evidence_maps(maps.samples, maps.grid, level_m, below)
        self._solid, self._free = smooth(solid, maps.sigma_m), AIR_WEIGHT * smooth(free, maps.sigma_m)

    def draw(self, group: int | None) -> Outline | None:
        """The outline without one group of sweeps."""
        solid, free = without(self._solid, group), without(self._free, group)
        evidence = free + solid
        share = free / (evidence + 1e-3 * evidence.max() + 1e-12)
        polygon = contour_around(share, 0.5, self._maps.grid, self._core.inside)
        if polygon is None:
            return None
        return _outline(self._maps, group, ObstacleKind.POTHOLE, polygon, moment_box(polygon_moments(polygon)))


class _Rise:
    """A thing ends halfway up its sides; a rise of the road where its flanks have run out."""

    def __init__(self, maps: _Maps, core: _Core) -> None:
        self._maps, self._core = maps, core
        self._count, self._total = relief_maps(maps.samples, maps.grid)
        self._reach_m = max(RISE_SIGMA_M, maps.sigma_m)
        polygon = self._contour(None, RISE_LEVEL_SHARE, self._reach_m)
        self._kind = ObstacleKind.DEBRIS if polygon is None else self._kind_of(polygon)

    def draw(self, group: int | None) -> Outline | None:
        """The outline without one group of sweeps."""
        if self._kind is ObstacleKind.BUMP:
            return self._bump(group)
        polygon = self._contour(group, RISE_LEVEL_SHARE, self._reach_m)
        return None if polygon is None else _outline(self._maps, group, self._kind, polygon, _least_rectangle(polygon))

    def _bump(self, group: int | None) -> Outline | None:
        low, high = (self._contour(group, share, self._maps.sigma_m) for share in FOOT_SHARES)
        if low is None or high is None:
            return None
        (length, width, yaw), (less_length, less_width, _) = (moment_box(polygon_moments(p)) for p in (low, high))
        foot = length + FOOT_ONWARD * max(length - less_length, 0.0), width + FOOT_ONWARD * max(width - less_width, 0.0)
        centroid = polygon_moments(low).centroid_m
        widened = centroid + (low - centroid) * math.sqrt(foot[0] * foot[1] / (length * width))
        return _outline(self._maps, group, self._kind, widened, (*foot, yaw))

    def _contour(self, group: int | None, share: float, sigma_m: float) -> FloatArray | None:
        """Where the height is a share of the rise's; gaps in a thing are bridged, and its shadow counts as road."""
        grid = self._maps.grid
        count, total = without(self._count, group), without(self._total, group)
        # A side facing the car collects many hits; cell means let it weigh no more than the road before it.
        hit = (count > 0.0).astype(np.float64)
        height = hit * np.clip(total / np.maximum(count, 1.0) / self._core.relief_m, 0.0, 1.0)
        near, high = smooth(np.stack([hit, height]), sigma_m)
        shares = high / (near + SHADOW_SHARE * float(np.median(near[self._core.inside])) + 1e-9)
        return contour_around(shares, share, grid, self._core.inside)

    def _kind_of(self, polygon: FloatArray) -> ObstacleKind:
        slope = np.hypot(*np.gradient(self._maps.relief, CELL_M))[self._maps.grid.inside(polygon)]
        steep = float(np.percentile(slope, 75)) if slope.size else 0.0
        _, width, _ = moment_box(polygon_moments(polygon))
        is_bump = steep < DEBRIS_SLOPE and self._core.relief_m < BUMP_MAX_HEIGHT_M and width > BUMP_MIN_WIDTH_M
        return ObstacleKind.BUMP if is_bump else ObstacleKind.DEBRIS


def _outline(maps: _Maps, group: int | None, kind: ObstacleKind, polygon: FloatArray, box: Box) -> Outline | None:
    """The outline with what lies inside; None for what is too narrow, or too long for the window."""
    inside = maps.grid.inside(polygon)
    relief = maps.samples.relief_m[inside[maps.cell] & (maps.samples.group != (-1 if group is None else group))]
    if box[1] < MIN_SIDE_M or box[0] > 2.0 * maps.grid.half_size_m or relief.size == 0:
        return None
    extreme = max(float(np.quantile(relief, EXTREME_SHARE)) - EXTREME_SDS * maps.noise_m, 0.0)
    centroid = polygon_moments(polygon).centroid_m
    greatest = extreme if kind is ObstacleKind.DEBRIS else extreme / SEEN_SHARE
    return Outline(kind, polygon, centroid, box, greatest, maps.relief, inside)


def _least_rectangle(polygon: FloatArray) -> Box:
    """The smallest rectangle around a polygon (K, 2): things have corners, which second moments would round off."""
    middle = polygon.mean(axis=0)
    _, (first, second), angle_deg = cv2.minAreaRect((polygon - middle).astype(np.float32))
    yaw = math.radians(angle_deg)
    return (first, second, fold_yaw(yaw)) if first >= second else (second, first, fold_yaw(yaw + math.pi / 2.0))
