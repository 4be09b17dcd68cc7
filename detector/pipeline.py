"""The detector, one line a step: a sweep in, classes, saliency and obstacles out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from detector.clusters import MAX_POINT_SD, Cluster, Deviations, find_clusters
from detector.corridor import Corridor, find_corridor, road_coordinates
from detector.recognition import recognise
from detector.saliency import SALIENT, saliency_map
from detector.segmentation import segment
from detector.surface import MARGIN_M, fit_surface
from detector.sweep import estimate_sensor_height, usable_points
from detector.types import DetectorError, DetectorInput, Findings, FloatArray, FrameDetection, IntArray

__all__ = ["Method", "detect", "estimate_sensor_height"]

Method = Literal["surface", "saliency"]

# Kerbs and the ground beside the road, for the search of edges.
EDGE_BAND_M = (-0.6, 1.0)


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
        raise DetectorError("state sensor_height_m, the sensor's height over the road")
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
    corridor = _corridor(points, sweep.curvature_per_m, sensor_height_m)
    strip = _strip(points, corridor, sensor_height_m)
    saliency = saliency_map(points) if method == "saliency" else _deviation_saliency(strip, len(points))
    candidates = strip.in_corridor & (saliency[strip.indices] > (SALIENT if method == "saliency" else 0.0))
    clusters = find_clusters(strip.deviations, candidates, corridor)
    labels = _labels(strip, candidates, clusters, points[:, 2] + sensor_height_m)
    obstacles = tuple(
        recognise(points[strip.indices], strip.deviations.residual_m, strip.deviations.noise_m, c) for c in clusters
    )
    residual = np.full(len(points), np.nan)
    residual[strip.indices] = strip.deviations.residual_m
    return Findings(labels, saliency, residual, obstacles)


def _corridor(points: FloatArray, curvature_per_m: float, sensor_height_m: float) -> Corridor:
    along, across = road_coordinates(points, curvature_per_m)
    height = points[:, 2] + sensor_height_m
    near_ground = (height > EDGE_BAND_M[0]) & (height < EDGE_BAND_M[1])
    return find_corridor(along[near_ground], across[near_ground], height[near_ground], curvature_per_m)


def _strip(points: FloatArray, corridor: Corridor, sensor_height_m: float) -> Strip:
    along, across = road_coordinates(points, corridor.curvature_per_m)
    indices = np.flatnonzero(corridor.contains(along, across, MARGIN_M))
    along, across, z = along[indices], across[indices], points[indices, 2]
    surface = fit_surface(along, across, z, corridor, sensor_height_m)
    if surface is None:
        indices, along, across, z = indices[:0], along[:0], across[:0], z[:0]
    range_m = np.hypot(along, across)
    residual = z - surface.height_m(along, across) if surface else z
    noise = surface.noise_at(range_m) if surface else z
    deviations = Deviations(along, across, range_m, residual, noise, sensor_height_m)
    return Strip(indices, deviations, corridor.contains(along, across))


def _deviation_saliency(strip: Strip, count: int) -> FloatArray:
    """How many standard deviations a point lies off the road, over the most that counts, in [0, 1]."""
    saliency = np.zeros(count)
    deviations = strip.deviations
    saliency[strip.indices] = np.minimum(np.abs(deviations.residual_m) / (MAX_POINT_SD * deviations.noise_m), 1.0)
    return saliency


def _labels(strip: Strip, candidates: np.ndarray, clusters: list[Cluster], height: FloatArray) -> np.ndarray:
    below, above, in_corridor, on_obstacle = (np.zeros(height.size, dtype=bool) for _ in range(4))
    in_corridor[strip.indices] = strip.in_corridor
    below[strip.indices] = candidates & strip.deviations.below
    above[strip.indices] = candidates & strip.deviations.above
    for cluster in clusters:
        on_obstacle[strip.indices[cluster.indices]] = True
    return segment(in_corridor, height, below, above, on_obstacle)


def _scatter(values: np.ndarray, indices: IntArray, full: np.ndarray) -> np.ndarray:
    full[indices] = values
    return full
