"""The roads' surface: crown, roughness, features and obstacles, as a height function and as meshes without cracks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from simulator.mesh import Mesh, grid, joined
from simulator.painting.texture import fractal_noise
from simulator.shapes.relief import Relief
from simulator.streets.road import OVERLAP_M, Road
from simulator.streets.street import PlacedFeature, PlacedObstacle, Roughness, Street

FloatArray = NDArray[np.float64]

COARSE_STEP_M, FINE_PARTS = 0.25, 13
"""Cells of the sound road, and into how many parts each is divided around a relief: 2 cm."""

FLAT_WITHIN_M = 0.0005
"""A tenth of the least range noise of a LiDAR: less is not worth three hundred triangles."""

ROUGHNESS_STEP_M, ROUGHNESS_PERIOD = 0.05, 1024
REFERENCE_FREQUENCY_PER_M = 0.1
"""n0 of ISO 8608."""

OVERLAP_DROP_M = 0.001
"""A side road begins this much below the road it overlaps, so that one surface is seen and not a mixture."""


def road_roughness(seed: int, roughness: Roughness) -> FloatArray:
    """Heights (n, n) of a periodic, isotropic road whose lines have the displacement density of an ISO 8608 class.

    The density Gd(n) = Gd(n0) (n / n0)^-2 (clause 5.1) holds on average over all lines, from wavelengths of 0.4 m to
    a quarter of the period.
    """
    # Along a line the density falls as n^-2, so an octave's amplitude as n^-0.5.
    noise = fractal_noise(seed, ROUGHNESS_PERIOD, slope=0.5)
    frequency_per_m = fft.rfftfreq(ROUGHNESS_PERIOD, ROUGHNESS_STEP_M)
    density_m3 = 2 * ROUGHNESS_STEP_M / ROUGHNESS_PERIOD * np.square(np.abs(fft.rfft(noise, axis=1))).mean(axis=0)
    band = np.s_[4 : ROUGHNESS_PERIOD // 8]
    at_reference = (density_m3 * np.square(frequency_per_m / REFERENCE_FREQUENCY_PER_M))[band].mean()
    return np.asarray(noise * math.sqrt(roughness.value / at_reference))


class Terrain:
    """Height of a street's roads, the same for the meshes, the wheels and the truth."""

    def __init__(self, street: Street) -> None:
        self.street = street
        self._roughness_m = road_roughness(street.seed, street.roughness)

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
        """Lattice along the road, its cells divided where a relief bends them; borders lie on the coarse edges."""
        lattice = _Lattice.of(road)
        coarse_m, road_m = self._surface(road, *lattice.at_corners())
        rows, columns = np.nonzero(self._touched(coarse_m))
        bent = self._bent(road, lattice, rows, columns)
        fine = np.zeros((len(lattice.s_m) - 1, len(lattice.u) - 1), dtype=bool)
        fine[rows[bent], columns[bent]] = True
        sound = grid(coarse_m, road_m, ~fine)
        return joined([sound, self._divided(road, lattice, fine, coarse_m)]) if fine.any() else sound

    def _touched(self, coarse_m: FloatArray) -> NDArray[np.bool_]:
        """Cells (rows, columns) that the box of a relief reaches into."""
        middle = (coarse_m[:-1, :-1] + coarse_m[1:, 1:]) / 2
        reach = float(np.linalg.norm(coarse_m[1:, 1:, :2] - coarse_m[:-1, :-1, :2], axis=-1).max()) / 2
        touched = np.zeros(middle.shape[:2], dtype=bool)
        for placed, relief in self._all_reliefs():
            u, v = placed.local(middle[..., 0], middle[..., 1])
            half_v, half_u = (size * relief.step_m / 2 + reach for size in relief.heights_m.shape)
            touched |= (np.abs(u) < half_u) & (np.abs(v) < half_v)
        return touched

    def _bent(
        self, road: Road, lattice: _Lattice, rows: NDArray[np.intp], columns: NDArray[np.intp]
    ) -> NDArray[np.bool_]:
        """Which cells (C,) two triangles would not follow within `FLAT_WITHIN_M`."""
        s, t = lattice.inside(rows, columns)
        plan = road.line.plan(s.ravel(), t.ravel())
        height = self._relief_height(plan[:, 0], plan[:, 1]).reshape(s.shape)
        return np.asarray(np.abs(height - _bilinear(height[..., None])[..., 0]).max(axis=(1, 2)) > FLAT_WITHIN_M)

    def _divided(self, road: Road, lattice: _Lattice, fine: NDArray[np.bool_], coarse_m: FloatArray) -> Mesh:
        rows, columns = np.nonzero(fine)
        vertices, road_m = self._surface(road, *lattice.inside(rows, columns))
        flat, framed = _bilinear(vertices), np.pad(fine, 1)
        for d_row, d_column, side in (
            (-1, 0, np.s_[:, 0]),
            (1, 0, np.s_[:, -1]),
            (0, -1, np.s_[:, :, 0]),
            (0, 1, np.s_[:, :, -1]),
        ):
            alone = ~framed[rows + 1 + d_row, columns + 1 + d_column]
            vertices[side][alone] = flat[side][alone]
        return _cells(vertices, road_m)

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
        roughness: FloatArray = ndimage.map_coordinates(self._roughness_m, index, order=1, mode="grid-wrap")
        return roughness + self._relief_height(x_m, y_m)

    def _relief_height(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """What obstacles and features add at positions (N,)."""
        added = np.zeros(len(x_m))
        for placed, relief in self._all_reliefs():
            near = np.flatnonzero(np.hypot(x_m - placed.x_m, y_m - placed.y_m) <= relief.reach_m)
            if near.size:
                added[near] += relief.height_at(*placed.local(x_m[near], y_m[near]))
        return added

    def _all_reliefs(self) -> list[tuple[PlacedObstacle | PlacedFeature, Relief]]:
        return [*self.reliefs, *((feature, feature.shape) for feature in self.street.features)]


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

    def inside(self, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        """Distances s and offsets t (C, P + 1, P + 1) of the vertices that divide cells (C,)."""
        share = np.linspace(0, 1, FINE_PARTS + 1)
        s = self.s_m[rows, None] * (1 - share) + self.s_m[rows + 1, None] * share
        u = self.u[columns, None] * (1 - share) + self.u[columns + 1, None] * share
        half = self.road.half_width(s.ravel()).reshape(s.shape)
        shape = (len(rows), FINE_PARTS + 1, FINE_PARTS + 1)
        return np.broadcast_to(s[:, :, None], shape), half[:, :, None] * u[:, None, :]


def mouth_stations(road: Road) -> FloatArray:
    """Distances s at which the rounded kerbs of a mouth are drawn."""
    angles = np.linspace(0, math.pi / 2, 13)
    return np.asarray(road.line.start_m + OVERLAP_M + road.mouth_radius_m * (1 - np.cos(angles)))


def _bilinear(vertices: FloatArray) -> FloatArray:
    """Values (C, P + 1, P + 1, K) replaced by those between the four corners of each cell."""
    share = np.linspace(0, 1, vertices.shape[1])
    across, along = share[None, None, :, None], share[None, :, None, None]
    first = vertices[:, :1, :1] * (1 - across) + vertices[:, :1, -1:] * across
    last = vertices[:, -1:, :1] * (1 - across) + vertices[:, -1:, -1:] * across
    return np.asarray(first * (1 - along) + last * along)


def _cells(vertices_m: FloatArray, road_m: FloatArray) -> Mesh:
    """One mesh of many small lattices (C, P + 1, P + 1, 3)."""
    count, size = len(vertices_m), vertices_m.shape[1]
    pattern = grid(vertices_m[0]).triangles
    triangles = (pattern[None] + size**2 * np.arange(count)[:, None, None]).reshape(-1, 3)
    return Mesh(vertices_m.reshape(-1, 3), triangles, road_m.reshape(-1, 3))
