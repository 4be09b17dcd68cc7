"""The detector, one line a step: a sweep in, classes, saliency and obstacles out."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numba import njit

from detector.arrays import FloatArray, IntArray, LabelArray
from detector.obstacles.clusters import MAX_POINT_SD
from detector.obstacles.recognition import recognise
from detector.obstacles.segmentation import STANDING_M, segment
from detector.obstacles.verification import Found, find_clusters
from detector.road.ground import height_over_profile
from detector.road.strip import Strip, road_strip
from detector.road.sweep import estimate_sensor_height, usable_points
from detector.road.view import sees_road
from detector.saliency.cloud_saliency import SALIENT, saliency_map
from detector.survey.pipeline import on_survey
from detector.types import DetectorInput, Findings, FrameDetection

__all__ = ["Method", "detect", "estimate_sensor_height"]

Method = Literal["surface", "saliency"]


def detect(sweep: DetectorInput, method: Method = "surface") -> FrameDetection:
    """Classes and saliency of every point of a sweep, and the obstacles on the road, in the `sensor` frame.

    `surface` is the default: residuals to a robust road surface. `saliency` is the paper's method. Points that are
    not finite are unclassified. Raises DetectorError for input that cannot be a sweep in metres.
    """
    points, usable = usable_points(sweep)
    if sweep.sensor_height_m is None:
        findings = on_survey(points, method)
    else:
        findings = _on_road(points, sweep, sweep.sensor_height_m, method)
    total = len(sweep.points_m)
    return FrameDetection(
        labels=_scatter(findings.labels, usable, np.zeros(total, dtype=np.uint8)),
        saliency=_scatter(findings.saliency, usable, np.zeros(total, dtype=np.float32)),
        residual_m=_scatter(findings.residual_m, usable, np.full(total, np.nan, dtype=np.float32)),
        obstacles=findings.obstacles,
        corridor=findings.corridor,
        road_seen=findings.road_seen,
    )


def _on_road(points: FloatArray, sweep: DetectorInput, sensor_height_m: float, method: Method) -> Findings:
    """What a sweep from a vehicle shows: usable points (M, 3), one viewpoint, a road that steering points along."""
    strip = road_strip(points, sensor_height_m, sweep.curvature_per_m)
    if method == "saliency":
        saliency = saliency_map(points)
        candidates = strip.in_corridor & (saliency[strip.indices] > SALIENT)
    else:
        of_strip = _deviation_saliency(strip.deviations.residual_m, strip.deviations.noise_m)
        saliency = _scatter(of_strip, strip.indices, np.zeros(len(points)))
        candidates = strip.in_corridor & (of_strip > 0.0)
    found = find_clusters(strip.deviations, candidates, strip.corridor)
    height = height_over_profile(points, sensor_height_m, sweep.curvature_per_m, np.array(strip.corridor.profile))
    obstacles = tuple(
        recognise(points[strip.indices], strip.deviations.residual_m, strip.deviations.noise_m, c)
        for c in found.clusters
    )
    residual = _scatter(strip.deviations.residual_m, strip.indices, np.full(len(points), np.nan))
    labels = _labels(points, height, strip, found)
    return Findings(labels, saliency, residual, obstacles, strip.corridor, _sees_road(strip))


@njit(cache=True, nogil=True)
def _deviation_saliency(residual: FloatArray, noise: FloatArray) -> FloatArray:
    """How many standard deviations a point lies off the road, over the most that counts, in [0, 1]."""
    saliency = np.empty(len(residual))
    for i in range(len(residual)):
        saliency[i] = min(abs(residual[i]) / (MAX_POINT_SD * noise[i]), 1.0)
    return saliency


def _sees_road(strip: Strip) -> bool:
    chosen, deviations = strip.in_corridor, strip.deviations
    return sees_road(deviations.along_m[chosen], deviations.across_m[chosen], deviations.residual_m[chosen])


def _labels(points: FloatArray, height_m: FloatArray, strip: Strip, found: Found) -> LabelArray:
    standing = (strip.deviations.residual_m > STANDING_M) & strip.in_corridor
    obstacles = [cluster.indices for cluster in found.clusters]
    return segment(
        points,
        height_m,
        strip.indices,
        safe=strip.in_corridor,
        below=found.low,
        above=found.high,
        standing=standing,
        on_obstacle=np.concatenate(obstacles) if obstacles else np.empty(0, dtype=np.int64),
    )


@njit(cache=True, nogil=True)
def _scatter(values: np.ndarray, indices: IntArray, full: np.ndarray) -> np.ndarray:
    for i in range(len(indices)):
        full[indices[i]] = values[i]
    return full
