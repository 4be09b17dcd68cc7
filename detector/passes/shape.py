"""The shape of one obstacle from all hits of a pass: outline by what rays hit and what they passed through.

The obvious estimators (a box around flagged points, cells) repeat within 7 to 20 % in area from pass to pass; this one
within 1 to 6 %, because it uses the ray and not only the hit, and second moments and not extremes.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import uniform_filter

from detector.arrays import FloatArray, IntArray
from detector.obstacles.descriptor import describe
from detector.obstacles.recognition import thin
from detector.passes.accumulator import RESIDUAL_BAND_M, PlaceHits
from detector.passes.height_map import CELL_M, Grid, Map
from detector.passes.local_surface import Levelled, levelled, usable
from detector.passes.outline import CORE_SHARE, Outline, outlines
from detector.passes.pass_maps import Samples
from detector.types import DetectedObstacle, ObstacleKind

MIN_HITS = 30
MIN_FRAMES = 2
GROUPS = 6
# Hits are kept up to the top of a band: what has more than this share of its own (from the height on that is no road's)
# right below the top goes on above it, as cars, walls and trees do. A wall that is cut off there has 4 %, a lorry's
# corner on a recorded drive 12 %, bollards that end 5 cm lower 0.1 %.
TOP_M, TOP_SHARE, STANDING_M = RESIDUAL_BAND_M[1] - 0.05, 0.02, 0.1
# What the sweeps of one pass share and so cannot show: floors of the standard deviations. Of ln(length) and ln(width)
# against the truth, from passes on tuning streets; a thing's sides depend on what of it was hit.
LN_SIDE_FLOOR = {ObstacleKind.POTHOLE: 0.042, ObstacleKind.BUMP: 0.06, ObstacleKind.DEBRIS: 0.12}
# Of ln(area) from pass to pass: what tells whether an obstacle has changed.
LN_AREA_FLOOR_FRONT = 0.03
LN_AREA_FLOOR_BOTH = 0.018
# Repeats of the centroid per pass: 0.8 to 1.7 cm from one side, 0.4 to 0.7 cm from both; and of the depth.
CENTRE_FLOOR_FRONT_M = 0.015
CENTRE_FLOOR_BOTH_M = 0.006
RELIEF_FLOOR_SHARE = 0.06


def measure(hits: PlaceHits, is_negative: bool) -> DetectedObstacle | None:
    """The obstacle of a sign nearest the middle of the window, in `odom`.

    None if there is none to be measured, or what rises there is higher than obstacles of the road.
    """
    hits = usable(hits)
    if len(hits.points_m) < MIN_HITS or np.unique(hits.frame).size < MIN_FRAMES:
        return None
    level = levelled(hits)
    relief = -level.height_m if is_negative else level.height_m
    group, groups = _groups(level.frame)
    samples = Samples(level.xy_m, relief, level.to_sensor, level.tangent, group, groups)
    whole, *parts = [*outlines(samples, Grid(hits.half_size_m), is_negative, level.noise_m)] or [None]
    if whole is None or (not is_negative and _goes_on_above(level, whole)):
        return None
    estimates = np.array([_estimates(part) for part in parts if part is not None]).reshape(-1, 6)
    return _obstacle(hits, level, whole, estimates, is_negative)


def _goes_on_above(level: Levelled, outline: Outline) -> bool:
    within_m = outline.box[0] / 2 + STANDING_M
    own = np.hypot(*(level.xy_m - outline.centroid_m).T) < within_m
    standing = own & (level.height_m > STANDING_M)
    return bool((level.height_m[standing] > TOP_M).sum() > TOP_SHARE * standing.sum())


def _groups(frame: IntArray) -> tuple[IntArray, int]:
    """Group (N,) of sweeps of each hit, every sixth sweep in the same, and the number of groups."""
    frames, number = np.unique(frame, return_inverse=True)
    return np.asarray(number % GROUPS, dtype=np.int64), min(GROUPS, frames.size)


def _estimates(outline: Outline) -> list[float]:
    """Logarithms of length, width and area, the relief and the centroid's x and y."""
    length, width, _ = outline.box
    sizes = [math.log(length), math.log(width), math.log(length * width)]
    return [*sizes, outline.relief_m, *outline.centroid_m]


def jackknife_covariance(estimates: FloatArray) -> FloatArray:
    """Covariance (T, T) of an estimator from its values (G, T) with one of G groups left out: (G - 1) / G sum d d^T."""
    groups = len(estimates)
    deviation = estimates - estimates.mean(axis=0)
    return np.asarray((groups - 1) / groups * deviation.T @ deviation)


def _obstacle(
    hits: PlaceHits, level: Levelled, outline: Outline, estimates: FloatArray, is_negative: bool
) -> DetectedObstacle:
    length, width, yaw = outline.box
    front, rear = views(hits)
    sd, centre_covariance = _uncertainty(estimates, outline.relief_m, outline.kind, front and rear)
    inside = outline.inside & (outline.relief_map > 0.0)
    relief = outline.relief_map[inside] if inside.any() else np.array([outline.relief_m])
    # Cells that no ray reached are as deep as the others.
    volume = float(relief.mean() * outline.inside.sum()) * CELL_M**2
    saliency = map_saliency(outline.relief_map)
    centre = np.array([*(hits.centre_odom_m + outline.centroid_m), level.road_height_m])
    offsets = np.column_stack([level.xy_m - outline.centroid_m, level.height_m])
    on_obstacle = np.hypot(offsets[:, 0], offsets[:, 1]) < length / 2.0 + CELL_M
    on_obstacle &= (-level.height_m if is_negative else level.height_m) > CORE_SHARE * outline.relief_m
    return DetectedObstacle(
        kind=outline.kind,
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


def _uncertainty(
    estimates: FloatArray, relief_m: float, kind: ObstacleKind, both_views: bool
) -> tuple[FloatArray, FloatArray]:
    """Standard deviations of ln length, ln width, ln area and relief (4,), and covariance of the centre (2, 2)."""
    if len(estimates) < 2:
        return np.array([0.3, 0.3, 0.4, 0.3 * relief_m]), np.diag([0.1**2, 0.1**2])
    side_floor, area_floor = LN_SIDE_FLOOR[kind], LN_AREA_FLOOR_BOTH if both_views else LN_AREA_FLOOR_FRONT
    centre_floor = CENTRE_FLOOR_BOTH_M if both_views else CENTRE_FLOOR_FRONT_M
    covariance = jackknife_covariance(estimates)
    floors = np.array([side_floor, side_floor, area_floor, RELIEF_FLOOR_SHARE * relief_m])
    sd = np.sqrt(np.diag(covariance)[:4] + floors**2)
    return sd, covariance[4:, 4:] + centre_floor**2 * np.eye(2)


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


def _confidence(relief_m: float, relief_sd_m: float, groups: int) -> float:
    """How sure it is that something is there: relief in standard deviations, and that every group of frames saw it."""
    return (1.0 - math.exp(-relief_m / (2.0 * relief_sd_m))) * (groups + 1) / (GROUPS + 1)
