"""The shape of one obstacle from all hits of a pass: outline by what rays hit and what they passed through.

The obvious estimators (a box around flagged points, cells) repeat within 7 to 20 % in area from pass to pass; this one
within 1 to 6 %, because it uses the ray and not only the hit, and second moments and not extremes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter

from detector.accumulator import PlaceHits
from detector.descriptor import Moments, describe, moment_box, polygon_moments
from detector.height_map import CELL_M, Grid, Map, contour_around, region_of, smooth_mean
from detector.local_surface import local_residuals
from detector.recognition import thin
from detector.types import DetectedObstacle, FloatArray, ObstacleKind

MIN_HITS = 30
MIN_FRAMES = 2
# Outline level as a share of the depth or height.
LEVEL_SHARE = 0.3
# Halfway up is unbiased for upright sides.
RISE_LEVEL_SHARE = 0.5
# Relief below this is texture and noise of the road.
MIN_RELIEF_M = 0.02
MIN_SIDE_M = 0.1
# A deep hit proves air only up to where its ray entered the hole; longer than this, the ray is too flat to be trusted.
MAX_AIR_M = 0.8
AIR_STEP_M = 0.02
# One ray leaves many air samples and only one solid one.
AIR_WEIGHT = 0.5
# In the shadow behind a rise, its last hits speak for this many sigmas around them.
HIT_REACH_SIGMAS = 1.6
# Only hits speak for a rise, no air: a pass from one side leaves 5 cm between them.
RISE_SIGMA_M = 0.04
GROUPS = 6
# What a pass does not see: floors of the standard deviation of ln(length), ln(width), ln(area), by view.
LN_FLOOR_FRONT = 0.04
LN_FLOOR_BOTH = 0.012
# Repeats of the centroid per pass: 0.8 to 1.7 cm from one side, 0.4 to 0.7 cm from both; and of the depth.
CENTRE_FLOOR_FRONT_M = 0.015
CENTRE_FLOOR_BOTH_M = 0.006
RELIEF_FLOOR_SHARE = 0.03
# A bump's flanks rise by less than one in two; the sides of what lies on the road are steeper, even smoothed.
DEBRIS_SLOPE = 0.6
# No bump of the road is higher than a speed hump may be.
BUMP_MAX_HEIGHT_M = 0.2
# A rise of the road is wider than a brick is long.
BUMP_MIN_WIDTH_M = 0.3
# How far from the middle of the window the obstacle may begin.
SEED_RADIUS_M = 0.8


@dataclass(frozen=True, slots=True)
class Outline:
    """Outline (K, 2) relative to the window's centre, its moments, and the map of depth or height it was drawn from."""

    polygon_m: FloatArray
    moments: Moments
    relief_m: float
    relief_map: Map
    inside: np.ndarray


@dataclass(frozen=True, slots=True)
class Samples:
    """Hits relative to the window's centre: xy (N, 2), depth or height (N,), direction from hit to sensor (N, 2) with
    the tangent of the ray's angle to the road (N,), frame (N,)."""

    xy_m: FloatArray
    relief_m: FloatArray
    to_sensor: FloatArray
    tangent: FloatArray
    frame: np.ndarray

    def without(self, dropped: np.ndarray) -> Samples:
        """The same without the masked hits."""
        kept = ~dropped
        return Samples(self.xy_m[kept], self.relief_m[kept], self.to_sensor[kept], self.tangent[kept], self.frame[kept])


def measure(hits: PlaceHits, is_negative: bool) -> DetectedObstacle | None:
    """The obstacle of a sign nearest the middle of the window, in `odom`; None if there is none to be measured."""
    if len(hits.points_m) < MIN_HITS or hits.frames < MIN_FRAMES:
        return None
    residual = local_residuals(hits)
    samples = _samples(hits, -residual if is_negative else residual)
    grid = Grid(hits.half_size_m)
    outline = _outline(samples, grid, is_negative)
    if outline is None:
        return None
    return _obstacle(hits, outline, _jackknife(samples, grid, is_negative), residual, is_negative)


def _samples(hits: PlaceHits, relief: FloatArray) -> Samples:
    to_sensor = hits.origins_m[hits.frame] - hits.points_m
    horizontal = np.maximum(np.hypot(to_sensor[:, 0], to_sensor[:, 1]), 1e-6)
    return Samples(
        hits.points_m[:, :2] - hits.centre_odom_m,
        relief,
        to_sensor[:, :2] / horizontal[:, None],
        np.maximum(to_sensor[:, 2] / horizontal, 1e-3),
        hits.frame,
    )


def _outline(samples: Samples, grid: Grid, is_negative: bool) -> Outline | None:
    """Outline: of a hole where as much speaks for air as for road at 0.3 of its depth, of a rise by its height."""
    relief_m = smooth_mean(grid, samples.xy_m, samples.relief_m)
    region = region_of(relief_m, grid, MIN_RELIEF_M, SEED_RADIUS_M)
    if region is None:
        return None
    relief = _mean_relief(relief_m[region])
    if relief < MIN_RELIEF_M:
        return None
    core = region & (relief_m > LEVEL_SHARE * relief)
    if is_negative:
        polygon = contour_around(_hole_share(samples, grid, LEVEL_SHARE * relief), 0.5, grid, core)
    else:
        polygon = contour_around(_rise_height(samples, grid, relief), RISE_LEVEL_SHARE, grid, core)
    if polygon is None:
        return None
    moments = polygon_moments(polygon)
    length, width, _ = moment_box(moments)
    if width < MIN_SIDE_M or length > 2.0 * grid.half_size_m:
        return None
    return Outline(polygon, moments, relief, relief_m, grid.inside(polygon))


def _mean_relief(values: FloatArray) -> float:
    """Mean of the 60 to 95 % quantile range of what lies deeper (higher) than 0.4 of the extreme."""
    deep = values[values > 0.4 * values.max()]
    low, high = np.quantile(deep, (0.6, 0.95))
    return float(deep[(deep >= low) & (deep <= high)].mean())


def _hole_share(samples: Samples, grid: Grid, level: float) -> Map:
    """Share (G, G) of air in what is known below the road: rays passed there, or hit the road."""
    deep = samples.relief_m > level
    solid = grid.smooth_count(samples.xy_m[~deep])
    free = AIR_WEIGHT * grid.smooth_count(_air_samples(samples, level))
    evidence = free + solid
    return np.asarray(free / (evidence + 1e-3 * evidence.max() + 1e-12))


def _air_samples(samples: Samples, level: float) -> FloatArray:
    """Places (M, 2) below `level` that rays passed through, from where they crossed it to their hit."""
    deep = samples.relief_m > level
    length = np.minimum((samples.relief_m[deep] - level) / samples.tangent[deep], MAX_AIR_M)
    steps = np.arange(0.0, MAX_AIR_M + AIR_STEP_M / 2, AIR_STEP_M)
    within = steps[None, :] <= length[:, None]
    places = samples.xy_m[deep][:, None, :] + steps[None, :, None] * samples.to_sensor[deep][:, None, :]
    return np.asarray(places[within])


def _rise_height(samples: Samples, grid: Grid, height_m: float) -> Map:
    """Height (G, G) as a share of the rise's; gaps in a thing are bridged, and its shadow counts as road."""
    # A side facing the car collects many hits; cell means let it weigh no more than the road before it.
    places, height = grid.cell_means(samples.xy_m, samples.relief_m)
    count = grid.smooth_count(places, sigma_m=RISE_SIGMA_M)
    total = grid.smooth_count(places, np.clip(height / height_m, 0.0, 1.0), RISE_SIGMA_M)
    return np.asarray(total / (count + grid.kernel_at(HIT_REACH_SIGMAS * RISE_SIGMA_M, RISE_SIGMA_M)))


def _jackknife(samples: Samples, grid: Grid, is_negative: bool) -> FloatArray:
    """Estimates (G, 6) without each group of frames: ln length, ln width, ln area, relief, centroid x and y."""
    frames = np.unique(samples.frame)
    group_of = np.zeros(int(frames.max()) + 1, dtype=np.int64)
    group_of[frames] = np.arange(frames.size) % GROUPS
    rows = []
    for group in range(min(GROUPS, frames.size)):
        outline = _outline(samples.without(group_of[samples.frame] == group), grid, is_negative)
        if outline is not None:
            length, width, _ = moment_box(outline.moments)
            sizes = [math.log(length), math.log(width), math.log(length * width)]
            rows.append([*sizes, outline.relief_m, *outline.moments.centroid_m])
    return np.array(rows).reshape(-1, 6)


def jackknife_covariance(estimates: FloatArray) -> FloatArray:
    """Covariance (T, T) of an estimator from its values (G, T) with one of G groups left out: (G - 1) / G sum d d^T."""
    groups = len(estimates)
    deviation = estimates - estimates.mean(axis=0)
    return np.asarray((groups - 1) / groups * deviation.T @ deviation)


def _obstacle(
    hits: PlaceHits, outline: Outline, estimates: FloatArray, residual: FloatArray, is_negative: bool
) -> DetectedObstacle:
    length, width, yaw = moment_box(outline.moments)
    front, rear = views(hits)
    sd, centre_covariance = _uncertainty(estimates, outline.relief_m, front and rear)
    inside = outline.inside & (outline.relief_map > 0.0)
    relief = outline.relief_map[inside] if inside.any() else np.array([outline.relief_m])
    volume = float(relief.sum()) * CELL_M**2
    saliency = map_saliency(outline.relief_map)
    centre = np.array([*(hits.centre_odom_m + outline.moments.centroid_m), _road_height(hits, residual)])
    offsets = hits.points_m - centre
    on_obstacle = np.hypot(offsets[:, 0], offsets[:, 1]) < length / 2.0 + CELL_M
    on_obstacle &= (-residual if is_negative else residual) > LEVEL_SHARE * outline.relief_m
    return DetectedObstacle(
        kind=_kind(outline, is_negative),
        centre_m=centre,
        length_m=length,
        width_m=width,
        yaw_rad=yaw,
        relief_m=outline.relief_m,
        volume_m3=volume,
        confidence=_confidence(outline.relief_m, sd[3], len(estimates)),
        hits=max(int(on_obstacle.sum()), 1),
        frames=hits.frames,
        least_range_m=float(np.hypot(*(hits.origins_m[:, :2] - centre[:2]).T).min()),
        view_front=front,
        view_rear=rear,
        ln_length_sd=float(sd[0]),
        ln_width_sd=float(sd[1]),
        ln_area_sd=float(sd[2]),
        relief_sd_m=float(sd[3]),
        centre_covariance_m2=centre_covariance,
        descriptor=describe(outline.polygon_m, length, width, relief, volume, saliency[outline.inside]),
        points_m=thin(offsets[on_obstacle]),
    )


def views(hits: PlaceHits) -> tuple[bool, bool]:
    """Whether a place was seen from the front (before it was passed) and from the rear, by the sensor's places."""
    travel = hits.origins_m[-1, :2] - hits.origins_m[0, :2]
    ahead = (hits.centre_odom_m - hits.origins_m[:, :2]) @ travel
    return bool((ahead >= 0.0).any()), bool((ahead < 0.0).any())


def _uncertainty(estimates: FloatArray, relief_m: float, both_views: bool) -> tuple[FloatArray, FloatArray]:
    """Standard deviations of ln length, ln width, ln area and relief (4,), and covariance of the centre (2, 2)."""
    if len(estimates) < 2:
        return np.array([0.3, 0.3, 0.4, 0.3 * relief_m]), np.diag([0.1**2, 0.1**2])
    ln_floor = LN_FLOOR_BOTH if both_views else LN_FLOOR_FRONT
    centre_floor = CENTRE_FLOOR_BOTH_M if both_views else CENTRE_FLOOR_FRONT_M
    covariance = jackknife_covariance(estimates)
    floors = np.array([ln_floor, ln_floor, ln_floor, RELIEF_FLOOR_SHARE * relief_m])
    sd = np.sqrt(np.diag(covariance)[:4] + floors**2)
    return sd, covariance[4:, 4:] + centre_floor**2 * np.eye(2)


def _road_height(hits: PlaceHits, residual: FloatArray) -> float:
    """Height in `odom` of the road at the window's middle third."""
    near = np.abs(hits.points_m[:, :2] - hits.centre_odom_m).max(axis=1) < hits.half_size_m / 3.0
    chosen = near if near.any() else np.ones_like(near)
    return float(np.median((hits.points_m[:, 2] - residual)[chosen]))


def map_saliency(relief_map: Map) -> Map:
    """Spectral saliency (G, G) on the absolute scale of a height map's normals in windows of 5 x 5 cells (10 cm)."""
    slope_x, slope_y = np.gradient(relief_map, CELL_M)
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)])
    normal /= np.linalg.norm(normal, axis=0)
    square = np.zeros_like(relief_map)
    for i in range(3):
        for j in range(3):
            square += uniform_filter(normal[i] * normal[j], size=5) ** 2
    return np.asarray(1.0 / np.sqrt(np.maximum(square, 1e-12)))


def _kind(outline: Outline, is_negative: bool) -> ObstacleKind:
    if is_negative:
        return ObstacleKind.POTHOLE
    slope = np.hypot(*np.gradient(outline.relief_map, CELL_M))[outline.inside]
    steep = float(np.percentile(slope, 75)) if slope.size else 0.0
    _, width, _ = moment_box(outline.moments)
    is_bump = steep < DEBRIS_SLOPE and outline.relief_m < BUMP_MAX_HEIGHT_M and width > BUMP_MIN_WIDTH_M
    return ObstacleKind.BUMP if is_bump else ObstacleKind.DEBRIS


def _confidence(relief_m: float, relief_sd_m: float, groups: int) -> float:
    """How sure it is that something is there: relief in standard deviations, and that every group of frames saw it."""
    return (1.0 - math.exp(-relief_m / (2.0 * relief_sd_m))) * (groups + 1) / (GROUPS + 1)
