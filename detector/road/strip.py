"""The road ahead of one sweep: its points on the corridor, and how far each lies off the surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from detector.arrays import FloatArray, IntArray
from detector.road.corridor import AHEAD_M, BEHIND_M, PATH_SCALE_M, Corridor, find_corridor
from detector.road.deviations import Deviations
from detector.road.ground import near_ground
from detector.road.surface import MARGIN_M, first_surface, sound_surface
from detector.road.sweep_rings import sweep_ring_offsets


@dataclass(frozen=True, slots=True)
class Strip:
    """The points on the corridor and its margin: indices (S,), deviations from the road, mask of the corridor."""

    corridor: Corridor
    indices: IntArray
    deviations: Deviations
    in_corridor: np.ndarray


def road_strip(points_m: FloatArray, sensor_height_m: float, curvature_per_m: float) -> Strip:
    """Strip of the road among points (N, 3) of the frame `sensor`; empty where too little road is seen."""
    ground = near_ground(points_m, sensor_height_m, curvature_per_m)
    corridor = find_corridor(ground, curvature_per_m)
    edges = (corridor.right_m - MARGIN_M, corridor.left_m + MARGIN_M)
    indices, along, across, height = _between(
        edges, corridor.path_m, ground.index, ground.along_m, ground.across_m, ground.height_m
    )
    deviations = _deviations(points_m, indices, along, across, height, corridor, sensor_height_m)
    if deviations is None:
        nothing = np.zeros(0)
        indices, deviations = indices[:0], Deviations(*(nothing,) * 5, sensor_height_m)
    in_corridor = corridor.contains(deviations.along_m, deviations.across_m)
    return Strip(corridor, indices, deviations, in_corridor)


@njit(cache=True, nogil=True)
def _between(
    edges: tuple[float, float],
    path: tuple[float, float, float],
    index: IntArray,
    along: FloatArray,
    across: FloatArray,
    height: FloatArray,
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Index, distance along, offset across the path and height (S,) of the ground's points (G,) between two edges."""
    count, kept = len(index), 0
    indices, s, t, z = np.empty(count, dtype=np.int64), np.empty(count), np.empty(count), np.empty(count)
    for i in range(count):
        part = along[i] / PATH_SCALE_M
        offset = across[i] - part * (path[0] + part * (path[1] + part * path[2]))
        if edges[0] < offset < edges[1] and -BEHIND_M < along[i] < AHEAD_M:
            indices[kept], s[kept], t[kept], z[kept] = index[i], along[i], offset, height[i]
            kept += 1
    return indices[:kept], s[:kept], t[:kept], z[:kept]


def _deviations(
    points_m: FloatArray,
    indices: IntArray,
    along_m: FloatArray,
    across_m: FloatArray,
    height_m: FloatArray,
    corridor: Corridor,
    sensor_height_m: float,
) -> Deviations | None:
    first = first_surface(along_m, across_m, height_m, corridor)
    if first is None:
        return None
    raw_m = first.residual_m(along_m, across_m, height_m)
    level_m = height_m - sweep_ring_offsets(points_m, indices, along_m, across_m, raw_m)
    surface = sound_surface(first, along_m, across_m, level_m)
    range_m = np.hypot(along_m, across_m)
    residual = surface.residual_m(along_m, across_m, level_m)
    return Deviations(along_m, across_m, range_m, residual, surface.noise_at(range_m, across_m), sensor_height_m)
