"""An obstacle of a survey from its outline: box, relief, volume, descriptor and how sure they are."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from skimage.measure import find_contours

from detector.arrays import FloatArray
from detector.obstacles.descriptor import describe, moment_box, polygon_moments
from detector.obstacles.recognition import thin
from detector.saliency.spectral import absolute_saliency
from detector.survey.holes import Hole
from detector.survey.road import LevelFrame, Relief
from detector.types import DetectedObstacle, ObstacleKind

# Evidence at which a thing is believed by 1 - 1/e, in standard deviations of the road's waves.
EVIDENCE_SCALE_SD = 6.0
# Points from which the descriptor's saliency is taken.
SALIENCY_POINTS = 64
DEBRIS_HEIGHT_M = 0.14
BUMP_MIN_LENGTH_M = 0.4


def describe_obstacle(
    relief: Relief, hole: Hole, of_hole: NDArray[np.bool_], volume_m3: float, frame: LevelFrame, is_negative: bool
) -> DetectedObstacle:
    """Obstacle in the frame of the input, from its cells and the mask (N,) of its points."""
    polygon = _polygon(relief, hole)
    moments = polygon_moments(polygon)
    length, width, yaw = moment_box(moments)
    depth = np.sort(relief.depth_m[of_hole])
    deepest = float(np.percentile(depth, 95))
    centre = frame.to_input(np.array([[*moments.centroid_m, 0.0]]))[0]
    direction = frame.level_from_input.T @ np.array([math.cos(yaw), math.sin(yaw), 0.0])
    points = frame.to_input(np.column_stack([relief.xy_m[of_hole], -relief.depth_m[of_hole]]))
    # The outline is uncertain by about a cell all around.
    cell = relief.grid.cell_m
    length_sd, width_sd = (cell / max(side, cell) for side in (length, width))
    return DetectedObstacle(
        kind=_kind(is_negative, deepest, length),
        centre_m=centre,
        length_m=length,
        width_m=width,
        yaw_rad=math.atan2(direction[1], direction[0]) % math.pi,
        relief_m=deepest,
        volume_m3=volume_m3,
        confidence=1.0 - math.exp(-hole.evidence_sd / EVIDENCE_SCALE_SD),
        hits=int(of_hole.sum()),
        frames=1,
        least_range_m=0.0,
        view_front=True,
        view_rear=True,
        ln_length_sd=length_sd,
        ln_width_sd=width_sd,
        ln_area_sd=math.hypot(length_sd, width_sd),
        relief_sd_m=math.hypot(relief.wave_m, relief.noise_m / math.sqrt(max(0.05 * depth.size, 1.0))),
        centre_covariance_m2=np.diag([cell * cell, cell * cell]),
        descriptor=describe(polygon, length, width, depth, volume_m3, _saliency(points)),
        points_m=thin(points - centre),
    )


def _polygon(relief: Relief, hole: Hole) -> FloatArray:
    """Outer contour (K, 2) of the cells, in the level frame."""
    contours = find_contours(np.pad(hole.outline.mask, 1).astype(np.float64), 0.5)
    longest = max(contours, key=len)
    cell = np.array([hole.outline.extent[1].start, hole.outline.extent[0].start]) - 0.5
    return np.asarray(relief.grid.origin_m + (longest[:-1, ::-1] + cell) * relief.grid.cell_m)


def _saliency(points_m: FloatArray) -> FloatArray:
    step = max(len(points_m) // SALIENCY_POINTS, 1)
    return np.array([absolute_saliency(points_m[::step])])


def _kind(is_negative: bool, height_m: float, length_m: float) -> ObstacleKind:
    if is_negative:
        return ObstacleKind.POTHOLE
    if height_m > DEBRIS_HEIGHT_M or length_m < BUMP_MIN_LENGTH_M:
        return ObstacleKind.DEBRIS
    return ObstacleKind.BUMP
