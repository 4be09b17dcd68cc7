"""The roads' surface: crown, roughness, features and obstacles, as a height function and as meshes without cracks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from simulator.mesh import Mesh, grid, joined
from simulator.pothole import Relief
from simulator.road import OVERLAP_M, Road
from simulator.street import PlacedFeature, PlacedObstacle, Roughness, Street
from simulator.texture import fractal_noise

FloatArray = NDArray[np.float64]

COARSE_STEP_M, FINE_PARTS = 0.25, 13
"""Cells of the sound road, and into how many parts each is divided around a relief: 2 cm."""

ROUGHNESS_STEP_M, ROUGHNESS_PERIOD = 0.05, 1024
REFERENCE_FREQUENCY_PER_M = 0.1
"""n0 of ISO 8608."""

OVERLAP_DROP_M = 0.001
"""A side road begins this much below the road it overlaps, so that one surface is seen and not a mixture."""


def roughness_sd_m(roughness: Roughness) -> float:
    """Standard deviation of the height over one period: the integral of Gd(n0) (n / n0)^-2 from its longest wave."""
    period_m = ROUGHNESS_PERIOD * ROUGHNESS_STEP_M
    shortest_m = 2 * ROUGHNESS_STEP_M
    return math.sqrt(roughness.value * REFERENCE_FREQUENCY_PER_M**2 * (period_m - shortest_m))


class Terrain:
    """Height of a street's roads, the same for the meshes, the wheels and the truth."""

    def __init__(self, street: Street) -> None:
        self.street = street
        # Along a line the spectral density of displacement falls as n^-2 (ISO 8608, 5.1), so an octave as n^-0.5.
        noise = fractal_noise(street.seed, ROUGHNESS_PERIOD, slope=0.5)
        self._roughness_m = roughness_sd_m(street.roughness) * noise

    @property
    def reliefs(self) -> tuple[tuple[PlacedObstacle, Relief], ...]:
        """The unfilled obstacles that are part of the road."""
        return tuple((o, o.shape) for o in self.street.obstacles if isinstance(o.shape, Relief) and not o.filled)

    def height_at(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """Height of the road with everything on it; arrays of equal shape, frame `street`."""
        x, y = np.ravel(x_m), np.ravel(y_m)
        height = self.street.sound_height(x, y) + self._worn(x, y)
        return np.asarray(height.reshape(np.shape(x_m)))

    def mesh(self, road: Road) -> Mesh:
        """Lattice along the road, fine around reliefs; where both meet, the fine border lies on the coarse edges."""
        lattice = _Lattice.of(road)
        coarse = self._surface(road, *lattice.at_corners())
        blocks = _merged([lattice.block(*self._reach(road, placed, relief)) for placed, relief in self._all_reliefs()])
        sound = np.ones((len(lattice.s_m) - 1, len(lattice.u) - 1), dtype=bool)
        for block in blocks:
            sound[block.rows, block.columns] = False
        return joined([grid(*coarse, sound), *(self._fine(road, lattice, block, coarse[0]) for block in blocks)])

    def _fine(self, road: Road, lattice: _Lattice, block: _Block, coarse_m: FloatArray) -> Mesh:
        row, column = block.fine()
        vertices, road_m = self._surface(road, *lattice.between(row, column))
        border = np.ones(row.shape, dtype=bool)
        border[1:-1, 1:-1] = False
        index = np.stack([row[border], column[border]])
        for axis in range(3):
            vertices[border, axis] = ndimage.map_coordinates(coarse_m[..., axis], index, order=1)
        return grid(vertices, road_m)

    def _surface(self, road: Road, s_m: FloatArray, t_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Vertices (..., 3) in the frame `street`, and (..., 3) s, t and height 0 of road positions."""
        s, t = s_m.ravel(), t_m.ravel()
        plan = road.line.plan(s, t)
        height = road.height(s, t) + self._worn(plan[:, 0], plan[:, 1])
        if road.joins is not None:
            height -= OVERLAP_DROP_M
        vertices = np.concatenate([plan, height[:, None]], axis=1)
        return vertices.reshape(*s_m.shape, 3), np.stack([s_m, t_m, np.zeros_like(s_m)], axis=-1)

    def _worn(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """What is added to the smooth road at positions (N,)."""
        index = np.stack([y_m, x_m]) / ROUGHNESS_STEP_M
        added: FloatArray = ndimage.map_coordinates(self._roughness_m, index, order=1, mode="grid-wrap")
        for placed, relief in self._all_reliefs():
            near = np.flatnonzero(np.hypot(x_m - placed.x_m, y_m - placed.y_m) <= relief.reach_m)
            added[near] += relief.height_at(*placed.local(x_m[near], y_m[near]))
        return added

    def _all_reliefs(self) -> list[tuple[PlacedObstacle | PlacedFeature, Relief]]:
        return [*self.reliefs, *((feature, feature.shape) for feature in self.street.features)]

    def _reach(self, road: Road, placed: PlacedObstacle | PlacedFeature, relief: Relief) -> tuple[float, float, float]:
        s, t = road.line.project(np.array([[placed.x_m, placed.y_m]]))
        return float(s[0]), float(t[0]), relief.reach_m


@dataclass(frozen=True, slots=True)
class _Block:
    """A rectangle of coarse cells that is meshed finely."""

    first_row: int
    end_row: int
    first_column: int
    end_column: int

    @property
    def rows(self) -> slice:
        return slice(self.first_row, self.end_row)

    @property
    def columns(self) -> slice:
        return slice(self.first_column, self.end_column)

    @property
    def empty(self) -> bool:
        return self.first_row >= self.end_row or self.first_column >= self.end_column

    def touches(self, other: _Block) -> bool:
        apart = self.end_row < other.first_row or other.end_row < self.first_row
        return not apart and self.end_column >= other.first_column and other.end_column >= self.first_column

    def with_(self, other: _Block) -> _Block:
        return _Block(
            min(self.first_row, other.first_row),
            max(self.end_row, other.end_row),
            min(self.first_column, other.first_column),
            max(self.end_column, other.end_column),
        )

    def fine(self) -> tuple[FloatArray, FloatArray]:
        """Fine vertices as fractional (row, column) of the coarse lattice."""
        axes = [
            np.linspace(first, end, (end - first) * FINE_PARTS + 1)
            for first, end in ((self.first_row, self.end_row), (self.first_column, self.end_column))
        ]
        row, column = np.meshgrid(*axes, indexing="ij")
        return row, column


@dataclass(frozen=True, slots=True)
class _Lattice:
    """Coarse lattice of a road: rows at distances s, columns at shares u of the half width, -1 right to 1 left."""

    road: Road
    s_m: FloatArray
    u: FloatArray

    @classmethod
    def of(cls, road: Road) -> _Lattice:
        s = np.linspace(road.line.start_m, road.line.end_m, math.ceil(road.line.length_m / COARSE_STEP_M) + 1)
        if road.joins is not None:
            s = np.unique(np.concatenate([s, mouth_stations(road)]))
        columns = math.ceil(2 * float(road.half_width(s).max()) / COARSE_STEP_M)
        return cls(road, s, np.linspace(-1.0, 1.0, columns + 1))

    def at_corners(self) -> tuple[FloatArray, FloatArray]:
        s, u = np.meshgrid(self.s_m, self.u, indexing="ij")
        return s, u * self.road.half_width(self.s_m)[:, None]

    def between(self, row: FloatArray, column: FloatArray) -> tuple[FloatArray, FloatArray]:
        s = np.interp(row, np.arange(len(self.s_m)), self.s_m)
        u = np.interp(column, np.arange(len(self.u)), self.u)
        return s, u * self.road.half_width(s.ravel()).reshape(s.shape)

    def block(self, s_m: float, t_m: float, reach_m: float) -> _Block:
        """The cells within `reach_m` of a road position; empty where it lies off the road."""
        half = float(self.road.half_width(np.array([s_m]))[0])
        if abs(t_m) > half + reach_m:
            return _Block(0, 0, 0, 0)
        rows = np.searchsorted(self.s_m, [s_m - reach_m, s_m + reach_m])
        columns = np.searchsorted(self.u, [(t_m - reach_m) / half, (t_m + reach_m) / half])
        return _Block(
            max(int(rows[0]) - 1, 0),
            min(int(rows[1]), len(self.s_m) - 1),
            max(int(columns[0]) - 1, 0),
            min(int(columns[1]), len(self.u) - 1),
        )


def mouth_stations(road: Road) -> FloatArray:
    """Distances s at which the rounded kerbs of a mouth are drawn."""
    angles = np.linspace(0, math.pi / 2, 13)
    return np.asarray(road.line.start_m + OVERLAP_M + road.mouth_radius_m * (1 - np.cos(angles)))


def _merged(blocks: list[_Block]) -> list[_Block]:
    """Blocks without common cells or borders."""
    waiting, apart = [block for block in blocks if not block.empty], list[_Block]()
    while waiting:
        block = waiting.pop()
        neighbour = next((other for other in apart if other.touches(block)), None)
        if neighbour is None:
            apart.append(block)
        else:
            apart.remove(neighbour)
            waiting.append(block.with_(neighbour))
    return apart
