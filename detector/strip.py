"""The road ahead of one sweep: its points on the corridor, and how far each lies off the surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detector.clusters import Deviations
from detector.corridor import Corridor, find_corridor
from detector.ground import GroundPoints, near_ground
from detector.surface import MARGIN_M, first_surface, sound_surface
from detector.sweep_rings import sweep_ring_offsets
from detector.types import FloatArray, IntArray


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
    across = ground.across_m - corridor.offset_m(ground.along_m)
    chosen = np.flatnonzero(corridor.contains(ground.along_m, across, MARGIN_M))
    deviations = _deviations(points_m[ground.index[chosen]], ground, chosen, across[chosen], corridor, sensor_height_m)
    if deviations is None:
        nothing = np.zeros(0)
        chosen, deviations = chosen[:0], Deviations(*(nothing,) * 5, sensor_height_m)
    in_corridor = corridor.contains(deviations.along_m, deviations.across_m)
    return Strip(corridor, ground.index[chosen], deviations, in_corridor)


def _deviations(
    points_m: FloatArray,
    ground: GroundPoints,
    chosen: IntArray,
    across: FloatArray,
    corridor: Corridor,
    sensor_height_m: float,
) -> Deviations | None:
    along, height = ground.along_m[chosen], ground.height_m[chosen]
    first = first_surface(along, across, height, corridor)
    if first is None:
        return None
    height = height - sweep_ring_offsets(points_m, along, across, height - first.height_m(along, across))
    surface = sound_surface(first, along, across, height)
    range_m = np.hypot(along, across)
    residual = height - surface.height_m(along, across)
    return Deviations(along, across, range_m, residual, surface.noise_at(range_m, across), sensor_height_m)
