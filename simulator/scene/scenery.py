"""What stands in and beside the street: everything but the road's surface, as parts with a surface class."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from simulator.mesh import Mesh

FloatArray = NDArray[np.float64]
Colour = tuple[float, float, float]


class Surface(IntEnum):
    """What a ray hit."""

    NOTHING = 0
    ROAD = 1
    KERB = 2
    PAVEMENT = 3
    GROUND = 4
    WALL = 5
    BUILDING = 6
    ROOF = 7
    CAR = 8
    WHEEL = 9
    TREE = 10
    TRUNK = 11
    POLE = 12
    DEBRIS = 13
    HILL = 14
    PEDESTRIAN = 15
    WATER = 16
    MANHOLE = 17
    ROAD_MARK = 18


@dataclass(frozen=True, slots=True)
class Part:
    """A mesh in its own frame, where it stands, what it is, its colour (linear RGB) and the obstacle it belongs to.

    `road` is the index of the road that a carriageway's mesh is of.
    """

    surface: Surface
    mesh: Mesh
    street_from_part: FloatArray = field(default_factory=lambda: np.eye(4))
    colour: Colour = (0.5, 0.5, 0.5)
    obstacle_id: int = 0
    road: int = 0
