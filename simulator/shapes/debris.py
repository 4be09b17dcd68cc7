"""Things that lie on the road: meshes standing on z = 0 about the middle of their plan."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, Delaunay

from simulator.mesh import Mesh, pose
from simulator.shapes import debris_shapes

FloatArray = NDArray[np.float64]
Colour = tuple[float, float, float]
Range = tuple[float, float]

WOOD: Colour = (0.25, 0.175, 0.105)


class DebrisKind(StrEnum):
    """What lies on the road."""

    PALLET = "pallet"
    TYRE = "tyre"
    TREAD = "tread"
    CARTON = "carton"
    ROCK = "rock"
    ROCKS = "rocks"
    TIMBER = "timber"
    EXHAUST = "exhaust"
    CONE = "cone"


@dataclass(frozen=True, slots=True)
class Debris:
    """A thing on the road, of one colour (linear RGB); its footprint is the convex hull of its plan."""

    mesh: Mesh
    colour: Colour = WOOD

    @property
    def length_m(self) -> float:
        """Extent along the local x."""
        return float(np.ptp(self.mesh.vertices_m[:, 0]))

    @property
    def width_m(self) -> float:
        """Extent along the local y."""
        return float(np.ptp(self.mesh.vertices_m[:, 1]))

    @property
    def relief_m(self) -> float:
        """Height above the road."""
        return float(self.mesh.vertices_m[:, 2].max())

    @property
    def footprint_area_m2(self) -> float:
        """Area of the plan's convex hull."""
        return float(ConvexHull(self.mesh.vertices_m[:, :2]).volume)

    @property
    def volume_m3(self) -> float:
        """Volume of the convex hull: what a car meets, not the wood alone."""
        return float(ConvexHull(self.mesh.vertices_m).volume)

    @property
    def reach_m(self) -> float:
        """Radius about the centre that holds the whole thing."""
        return float(np.hypot(*self.mesh.vertices_m[:, :2].T).max())

    def covers(self, x_m: FloatArray, y_m: FloatArray) -> NDArray[np.bool_]:
        """Whether local positions lie inside the footprint."""
        plan = Delaunay(self.mesh.vertices_m[:, :2])
        return np.asarray(plan.find_simplex(np.stack([x_m, y_m], axis=-1)) >= 0)

    def grown(self, area_factor: float) -> Debris:
        """The same thing with `area_factor` times the footprint's area and the same height."""
        side = math.sqrt(area_factor)
        return replace(self, mesh=self.mesh.scaled(side, side, 1.0))


@dataclass(frozen=True, slots=True)
class _Make:
    """How a kind is built, its colour, and the ranges of its size in metres."""

    mesh: Callable[[np.random.Generator], Mesh]
    colour: Colour
    length_m: Range
    width_m: Range
    height_m: Range


# Sizes: EUR pallets are 1.2 x 0.8 m, car tyres 0.58 to 0.70 m across and 0.175 to 0.245 m wide (ETRTO), British
# traffic cones 0.5 to 1.0 m high (Traffic Signs Manual, chapter 8); the others are of common loads.
_MAKES = {
    DebrisKind.PALLET: _Make(debris_shapes.pallet, WOOD, (0.7, 1.2), (0.5, 0.8), (0.15, 0.35)),
    DebrisKind.TYRE: _Make(debris_shapes.tyre, (0.022, 0.022, 0.023), (0.58, 0.70), (0.58, 0.70), (0.175, 0.245)),
    DebrisKind.TREAD: _Make(debris_shapes.tread, (0.028, 0.027, 0.026), (0.8, 1.8), (0.22, 0.35), (0.12, 0.35)),
    DebrisKind.CARTON: _Make(debris_shapes.carton, (0.30, 0.19, 0.10), (0.4, 0.8), (0.3, 0.6), (0.2, 0.5)),
    DebrisKind.ROCK: _Make(debris_shapes.rock, (0.20, 0.185, 0.165), (0.25, 0.6), (0.2, 0.5), (0.15, 0.4)),
    DebrisKind.ROCKS: _Make(debris_shapes.rocks, (0.20, 0.185, 0.165), (0.8, 1.6), (0.7, 1.4), (0.15, 0.35)),
    DebrisKind.TIMBER: _Make(debris_shapes.timber, WOOD, (1.6, 3.0), (0.3, 0.6), (0.10, 0.18)),
    DebrisKind.EXHAUST: _Make(debris_shapes.exhaust, (0.115, 0.10, 0.09), (0.9, 1.6), (0.25, 0.5), (0.13, 0.25)),
    DebrisKind.CONE: _Make(debris_shapes.cone, (0.60, 0.085, 0.025), (0.55, 0.95), (0.30, 0.45), (0.28, 0.42)),
}


def debris(kind: DebrisKind, seed: int, length_m: float, width_m: float, height_m: float) -> Debris:
    """A thing of that kind, stretched to fill a box; `ValueError` unless the sizes are 2 cm to 10 m."""
    for name, size in (("length_m", length_m), ("width_m", width_m), ("height_m", height_m)):
        if not 0.02 <= size <= 10:
            raise ValueError(f"{name} of debris must be between 0.02 and 10, not {size}")
    make = _MAKES[kind]
    return Debris(_fitted(make.mesh(np.random.default_rng(seed)), length_m, width_m, height_m), make.colour)


def random_sizes(kind: DebrisKind, seed: int) -> tuple[float, float, float]:
    """Plausible length, width and height in metres of a thing of that kind."""
    rng, make = np.random.default_rng([seed, 2]), _MAKES[kind]
    length, width, height = (
        round(float(rng.uniform(*sides)), 3) for sides in (make.length_m, make.width_m, make.height_m)
    )
    # A tyre is round whatever its size.
    return length, length if kind is DebrisKind.TYRE else width, height


def random_debris(seed: int) -> Debris:
    """Any thing, of a plausible size."""
    kind = list(DebrisKind)[np.random.default_rng([seed, 3]).integers(len(DebrisKind))]
    return debris(kind, seed, *random_sizes(kind, seed))


def broken_pallet(seed: int, length_m: float, width_m: float, height_m: float) -> Debris:
    """Half a wooden pallet that came down on a block."""
    return debris(DebrisKind.PALLET, seed, length_m, width_m, height_m)


def _fitted(mesh: Mesh, length_m: float, width_m: float, height_m: float) -> Mesh:
    """The mesh moved and stretched to fill a box about the z axis on z = 0."""
    low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
    shift = pose(-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2])
    stretch = np.array([length_m, width_m, height_m]) / (high - low)
    return mesh.moved(shift).scaled(*stretch)
