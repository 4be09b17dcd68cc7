"""The road ahead of one sweep: its points on the corridor, and how far each lies off the surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detector.clusters import Deviations
from detector.corridor import Corridor, find_corridor
from detector.ground import GroundPoints, near_ground
from detector.surface import MARGIN_M, fit_surface
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
    return _strip(ground, find_corridor(ground, curvature_per_m), sensor_height_m)


def _strip(ground: GroundPoints, corridor: Corridor, sensor_height_m: float) -> Strip:
    across = ground.across_m - corridor.offset_m(ground.along_m)
    chosen = np.flatnonzero(corridor.contains(ground.along_m, across, MARGIN_M))
    along, across, height = ground.along_m[chosen], across[chosen], ground.height_m[chosen]
    surface = fit_surface(along, across, height, corridor)
    if surface is None:
        chosen, along, across, height = chosen[:0], along[:0], across[:0], height[:0]
    range_m = np.hypot(along, across)
    residual = height - surface.height_m(along, across) if surface else height
    noise = surface.noise_at(range_m, across) if surface else height
    deviations = Deviations(along, across, range_m, residual, noise, sensor_height_m)
    return Strip(corridor, ground.index[chosen], deviations, corridor.contains(along, across))
