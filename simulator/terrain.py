"""The road's surface: crown, roughness and obstacles' reliefs, as a height function and as a mesh without cracks."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from simulator.mesh import Mesh, grid
from simulator.pothole import Relief
from simulator.street import PlacedObstacle, Street
from simulator.texture import fractal_noise

FloatArray = NDArray[np.float64]

DRAWN_BEYOND_M = 160.0
"""The road goes on beyond both ends: farther than the LiDAR's 100 m, and lost in the haze."""

FINE_STEP_M, COARSE_STEP_M = 0.02, 0.25
ROUGHNESS_STEP_M = 0.05
ROUGHNESS_PERIOD = 1024


class Terrain:
    """Height of a street's road, the same for the mesh, the wheels and the truth."""

    def __init__(self, street: Street) -> None:
        self.street = street
        # ISO 8608: along a line the spectral density of displacement falls as n^-2, so an octave as n^-0.5.
        self._roughness_m = street.roughness_sd_m * fractal_noise(street.seed, ROUGHNESS_PERIOD, slope=0.5)

    @property
    def reliefs(self) -> tuple[tuple[PlacedObstacle, Relief], ...]:
        """The unfilled obstacles that are part of the road."""
        return tuple((o, o.shape) for o in self.street.obstacles if isinstance(o.shape, Relief) and not o.filled)

    def height_at(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """Height of the road with its obstacles; arrays of equal shape."""
        height = self.street.crown_height(y_m) + self._roughness_at(x_m, y_m)
        for placed, relief in self.reliefs:
            near = np.hypot(x_m - placed.x_m, y_m - placed.y_m) <= relief.reach_m
            height[near] += relief.height_at(*placed.local(x_m[near], y_m[near]))
        return np.asarray(height)

    def mesh(self) -> Mesh:
        """Tensor grid: 2 cm around reliefs, coarse elsewhere; neighbours share their vertices."""
        half_width = self.street.road_width_m / 2
        around = [(placed.x_m, placed.y_m, relief.reach_m) for placed, relief in self.reliefs]
        xs = _lines(-DRAWN_BEYOND_M, self.street.length_m + DRAWN_BEYOND_M, [(x - r, x + r) for x, _, r in around])
        ys = _lines(-half_width, half_width, [(y - r, y + r) for _, y, r in around])
        x, y = np.meshgrid(xs, ys)
        return grid(np.stack([x, y, self.height_at(x, y)], axis=-1))

    def _roughness_at(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        index = np.stack([y_m, x_m]) / ROUGHNESS_STEP_M
        roughness: FloatArray = ndimage.map_coordinates(self._roughness_m, index, order=1, mode="grid-wrap")
        return roughness


def _lines(low: float, high: float, fine: list[tuple[float, float]]) -> FloatArray:
    """Grid lines from low to high: coarse cells that touch a fine interval are divided evenly, so none is a sliver."""
    coarse = np.linspace(low, high, round((high - low) / COARSE_STEP_M) + 1)
    cells = [(a, b, any(a < end and b > start for start, end in fine)) for a, b in itertools.pairwise(coarse)]
    parts = math.ceil(COARSE_STEP_M / FINE_STEP_M)
    divided = [np.linspace(a, b, parts if touched else 1, endpoint=False) for a, b, touched in cells]
    return np.concatenate([*divided, coarse[-1:]])
