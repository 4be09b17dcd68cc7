"""The detector on a survey, one line a step: a dense patch of road without one viewpoint."""

from __future__ import annotations

from typing import Literal

import numpy as np

from detector.arrays import FloatArray, LabelArray
from detector.survey.holes import Hole, find_holes
from detector.survey.obstacle import describe_obstacle
from detector.survey.road import LevelFrame, Relief, level, relief
from detector.survey.saliency import salient_points
from detector.survey.support import below_road
from detector.survey.volume import volume_below
from detector.types import DetectedObstacle, Findings, PointClass

# Fewer points are no surface.
MIN_POINTS = 50
# Deviations count up to this many standard deviations towards the saliency.
MAX_POINT_SD = 8.0
# Half of a hole's points lie this share of its depth below the road, also where it has a wide apron.
MIN_MEDIAN_SHARE = 0.15
MIN_HOLE_POINTS = 5


def on_survey(points_m: FloatArray, method: Literal["surface", "saliency"]) -> Findings:
    """Classes, saliency, residual and obstacles of a dense cloud (M, 3) in metres, z up.

    The road is the level that most points lie near. `surface` judges the depth below it against the noise and the
    road's own waves; `saliency` is the paper's method on the same points.
    """
    measured = None
    if len(points_m) >= MIN_POINTS:
        frame = level(points_m)
        measured = relief(frame.to_level(points_m))
    if measured is None:
        nothing = np.zeros(len(points_m))
        return Findings(nothing.astype(np.uint8), nothing, np.full(len(points_m), np.nan), (), road_seen=False)
    if method == "saliency":
        return _by_saliency(points_m, frame, measured)
    return _by_surface(frame, measured)


def _by_surface(frame: LevelFrame, measured: Relief) -> Findings:
    labels = np.full(len(measured.depth_m), PointClass.SAFE_ROAD, dtype=np.uint8)
    obstacles = []
    for side, flagged in ((measured.upside_down(), PointClass.POSITIVE), (measured, PointClass.NEGATIVE)):
        obstacles += _one_side(frame, side, labels, flagged)
    sd = np.hypot(measured.noise_m, measured.wave_m)
    saliency = np.minimum(np.abs(measured.depth_m) / (MAX_POINT_SD * sd), 1.0)
    return Findings(labels, saliency, -measured.depth_m, tuple(obstacles))


def _one_side(frame: LevelFrame, side: Relief, labels: LabelArray, flagged: PointClass) -> list[DetectedObstacle]:
    """Obstacles below (or, upside down, above) the road; writes the classes of their points."""
    holes = [hole for hole in find_holes(side) if _is_shared(side, hole)]
    if not holes:
        return []
    inside = np.zeros(side.grid.shape, dtype=np.int64)
    for number, hole in enumerate(holes, start=1):
        inside[hole.outline.extent][hole.outline.mask] = number
    support = below_road(side, inside > 0)
    labels[support] = flagged
    number_of_point = inside.ravel()[side.cells]
    labels[number_of_point > 0] = PointClass.OBSTACLE
    volumes = volume_below(side, inside, support)
    return [
        describe_obstacle(side, hole, number_of_point == n, volumes[n], frame, flagged is PointClass.NEGATIVE)
        for n, hole in enumerate(holes, start=1)
    ]


def _is_shared(side: Relief, hole: Hole) -> bool:
    """Whether the points of a hole are in it, and not one stray point among many of the road."""
    inside = np.zeros(side.grid.shape, dtype=bool)
    inside[hole.outline.extent] = hole.outline.mask
    depth = side.depth_m[inside.ravel()[side.cells]]
    greatest_m = hole.evidence_sd * side.wave_m
    return depth.size >= MIN_HOLE_POINTS and float(np.median(depth)) >= MIN_MEDIAN_SHARE * greatest_m


def _by_saliency(points_m: FloatArray, frame: LevelFrame, measured: Relief) -> Findings:
    saliency, salient = salient_points(points_m)
    labels = np.full(len(points_m), PointClass.SAFE_ROAD, dtype=np.uint8)
    labels[salient] = PointClass.NEGATIVE
    return Findings(labels, saliency, -measured.depth_m, ())
