"""An obstacle from the points of one cluster in one sweep: rough box, relief, confidence and descriptor."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from detector.arrays import Float32Array, FloatArray
from detector.obstacles.clusters import Cluster
from detector.obstacles.descriptor import describe, fold_yaw
from detector.saliency.spectral import absolute_saliency
from detector.types import DetectedObstacle, ObstacleKind

MAX_POINTS = 512
THIN_CELL_M = 0.02
# The box of flagged points of a single view repeats within 14 to 22 % in area: about 0.15 in each length.
LN_LENGTH_SD = 0.15
LN_AREA_SD = 0.22
MIN_SIDE_M = 0.05
# Speed humps are at most 10 to 12 cm high by regulation; what is higher lies on the road.
DEBRIS_HEIGHT_M = 0.14
BUMP_MIN_LENGTH_M = 0.4


def recognise(points_m: FloatArray, residual_m: FloatArray, noise_m: FloatArray, cluster: Cluster) -> DetectedObstacle:
    """Obstacle in the frame of the points (N, 3), from one sweep; the sizes are rough and say so."""
    points = points_m[cluster.indices]
    relief = np.abs(residual_m[cluster.indices])
    centre_xy, length, width, yaw = _aligned_box(points[:, :2])
    depth = float(np.percentile(relief, 90))
    road_z = float(np.median(points[:, 2] - residual_m[cluster.indices]))
    centre = np.array([*centre_xy, road_z])
    noise = float(np.mean(noise_m[cluster.indices]))
    outline = _outline(points[:, :2], centre_xy, length, width, yaw)
    # Half the box's corners are missing in an ellipse-like footprint: pi / 4 of the box.
    volume = math.pi / 4.0 * length * width * float(relief.mean())
    saliency = np.array([absolute_saliency(points)])
    return DetectedObstacle(
        kind=_kind(cluster.is_negative, depth, length),
        centre_m=centre,
        length_m=length,
        width_m=width,
        yaw_rad=yaw,
        relief_m=depth,
        volume_m3=volume,
        confidence=cluster.confidence,
        hits=len(points),
        frames=1,
        least_range_m=float(np.hypot(points[:, 0], points[:, 1]).min()),
        view_front=bool(centre[0] > 0.0),
        view_rear=bool(centre[0] <= 0.0),
        ln_length_sd=LN_LENGTH_SD,
        ln_width_sd=LN_LENGTH_SD,
        ln_area_sd=LN_AREA_SD,
        relief_sd_m=max(noise, 0.1 * depth),
        centre_covariance_m2=np.diag([(0.15 * length) ** 2, (0.15 * length) ** 2]),
        descriptor=describe(outline, length, width, relief, volume, saliency),
        points_m=thin(points - centre),
    )


def thin(points_m: FloatArray) -> Float32Array:
    """At most 512 points (M, 3): the first of each voxel, voxels doubled until they suffice."""
    size = THIN_CELL_M
    while True:
        voxels = np.floor(points_m / size).astype(np.int64)
        # One number a voxel: rows of three are sorted ten times as slowly.
        x, y, z = (voxels - voxels.min(axis=0, initial=0)).T
        _, first = np.unique((x * (y.max(initial=0) + 1) + y) * (z.max(initial=0) + 1) + z, return_index=True)
        if first.size <= MAX_POINTS:
            return np.ascontiguousarray(points_m[np.sort(first)], dtype=np.float32)
        size *= 2.0**0.5


def _aligned_box(xy: FloatArray) -> tuple[FloatArray, float, float, float]:
    """Centre (2,), length, width and yaw of the box along the points' principal axes."""
    mean = xy.mean(axis=0)
    _, vectors = np.linalg.eigh(np.cov((xy - mean).T) + 1e-9 * np.eye(2))
    axes = vectors[:, ::-1]
    along = (xy - mean) @ axes
    low, high = along.min(axis=0), along.max(axis=0)
    sides = np.maximum(high - low, MIN_SIDE_M)
    centre = mean + axes @ (0.5 * (low + high))
    direction = axes[:, 0] if sides[0] >= sides[1] else axes[:, 1]
    return centre, float(sides.max()), float(sides.min()), fold_yaw(math.atan2(direction[1], direction[0]))


def _outline(xy: FloatArray, centre: FloatArray, length: float, width: float, yaw: float) -> FloatArray:
    """Convex hull of the points, or the box's corners where the points lie on a line."""
    if len(xy) >= 3:
        try:
            hull = xy[ConvexHull(xy).vertices]
        except QhullError:
            hull = xy[:0]
        if len(hull) >= 3:
            return np.asarray(hull)
    u = np.array([math.cos(yaw), math.sin(yaw)]) * length / 2.0
    v = np.array([-math.sin(yaw), math.cos(yaw)]) * width / 2.0
    return np.array([centre + u + v, centre - u + v, centre - u - v, centre + u - v])


def _kind(is_negative: bool, height_m: float, length_m: float) -> ObstacleKind:
    """A first guess; whether a rise is a bump or debris is decided over several sweeps (`detector.passes.shape`)."""
    if is_negative:
        return ObstacleKind.POTHOLE
    if height_m > DEBRIS_HEIGHT_M or length_m < BUMP_MIN_LENGTH_M:
        return ObstacleKind.DEBRIS
    return ObstacleKind.BUMP
