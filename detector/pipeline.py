"""The detector, one line a step: a sweep in, classes, saliency and obstacles out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from detector.clusters import MAX_POINT_SD, Cluster, Deviations
from detector.corridor import Corridor, find_corridor
from detector.ground import GroundPoints, near_ground, profile_height
from detector.recognition import recognise
from detector.saliency import SALIENT, saliency_map
from detector.segmentation import segment
from detector.surface import MARGIN_M, fit_surface
from detector.survey import on_survey
from detector.sweep import estimate_sensor_height, usable_points
from detector.types import (
    DetectorInput,
    Findings,
    FloatArray,
    FrameDetection,
    IntArray,
    LabelArray,
)
from detector.verification import find_clusters

__all__ = ["Method", "detect", "estimate_sensor_height"]

Method = Literal["surface", "saliency"]


@dataclass(frozen=True, slots=True)
class Strip:
    """The points on the corridor and its margin: indices (S,), deviations from the road, mask of the corridor."""

    indices: IntArray
    deviations: Deviations
    in_corridor: np.ndarray


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
    )


def _on_road(points: FloatArray, sweep: DetectorInput, sensor_height_m: float, method: Method) -> Findings:
    """What a sweep from a vehicle shows: usable points (M, 3), one viewpoint, a road that steering points along."""
    ground = near_ground(points, sensor_height_m, sweep.curvature_per_m)
    corridor = find_corridor(ground, sweep.curvature_per_m)
    strip = _strip(ground, corridor, sensor_height_m)
    saliency = saliency_map(points) if method == "saliency" else _deviation_saliency(strip, len(points))
    candidates = strip.in_corridor & (saliency[strip.indices] > (SALIENT if method == "saliency" else 0.0))
    clusters = find_clusters(strip.deviations, candidates, corridor)
    height = points[:, 2] + sensor_height_m - profile_height(points[:, 0], ground.profile)
    obstacles = tuple(
        recognise(points[strip.indices], strip.deviations.residual_m, strip.deviations.noise_m, c) for c in clusters
    )
    residual = np.full(len(points), np.nan)
    residual[strip.indices] = strip.deviations.residual_m
    return Findings(_labels(strip, candidates, clusters, height), saliency, residual, obstacles)


def _strip(ground: GroundPoints, corridor: Corridor, sensor_height_m: float) -> Strip:
    across = ground.across_m - corridor.offset_m(ground.along_m)
    chosen = np.flatnonzero(corridor.contains(ground.along_m, across, MARGIN_M))
    along, across, height = ground.along_m[chosen], across[chosen], ground.height_m[chosen]
    surface = fit_surface(along, across, height, corridor)
    if surface is None:
        chosen, along, across, height = chosen[:0], along[:0], across[:0], height[:0]
    range_m = np.hypot(along, across)
    residual = height - surface.height_m(along, across) if surface else height
    noise = surface.noise_at(range_m) if surface else height
    deviations = Deviations(along, across, range_m, residual, noise, sensor_height_m)
    return Strip(ground.index[chosen], deviations, corridor.contains(along, across))


def _deviation_saliency(strip: Strip, count: int) -> FloatArray:
    """How many standard deviations a point lies off the road, over the most that counts, in [0, 1]."""
    saliency = np.zeros(count)
    deviations = strip.deviations
    saliency[strip.indices] = np.minimum(np.abs(deviations.residual_m) / (MAX_POINT_SD * deviations.noise_m), 1.0)
    return saliency


def _labels(strip: Strip, candidates: np.ndarray, clusters: list[Cluster], height_m: FloatArray) -> LabelArray:
    found = [strip.indices[cluster.indices] for cluster in clusters]
    return segment(
        height_m,
        strip.indices[strip.in_corridor & ~strip.deviations.below & ~strip.deviations.above],
        strip.indices[candidates & strip.deviations.below],
        strip.indices[candidates & strip.deviations.above],
        np.concatenate(found) if found else strip.indices[:0],
    )


def _scatter(values: np.ndarray, indices: IntArray, full: np.ndarray) -> np.ndarray:
    full[indices] = values
    return full
