"""What stands in and beside the street: everything but the road's surface, as parts with a surface class."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from simulator import car
from simulator.debris import Debris
from simulator.mesh import Mesh, box, cylinder, extruded, grid, joined, pose
from simulator.street import Street
from simulator.terrain import DRAWN_BEYOND_M, Terrain

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


@dataclass(frozen=True, slots=True)
class Part:
    """A mesh in its own frame, where it stands, what it is, its colour (linear RGB) and the obstacle it belongs to."""

    surface: Surface
    mesh: Mesh
    street_from_part: FloatArray = field(default_factory=lambda: np.eye(4))
    colour: Colour = (0.5, 0.5, 0.5)
    obstacle_id: int = 0


WALL_Y_M, WALL_THICKNESS_M, WALL_HEIGHT_M = -5.5, 0.25, 1.5
HOUSE_FRONT_M = 7.2
PLASTERS: tuple[Colour, ...] = (
    (0.46, 0.37, 0.24),
    (0.50, 0.47, 0.41),
    (0.38, 0.21, 0.14),
    (0.33, 0.37, 0.39),
    (0.52, 0.42, 0.22),
    (0.44, 0.29, 0.23),
    (0.24, 0.29, 0.24),
)
TUFTS, TUFT_HALF_M = 3_000, 0.10
GREENS: tuple[Colour, ...] = ((0.11, 0.17, 0.04), (0.14, 0.19, 0.045), (0.085, 0.15, 0.045), (0.16, 0.18, 0.06))


def furnish(terrain: Terrain) -> list[Part]:
    """Every part of the street except the road, seeded by the street."""
    street = terrain.street
    rng = np.random.default_rng([street.seed, 1])
    return [
        *_borders(street),
        *_houses(street, rng),
        *_trees(street, rng),
        *_lamps(street),
        *_parked_cars(street),
        *_debris(terrain),
        _hills(rng),
    ]


def _borders(street: Street) -> list[Part]:
    """Kerbs, pavements, the wall and the ground behind, as profiles drawn along the street."""
    xs = np.arange(-DRAWN_BEYOND_M, street.length_m + DRAWN_BEYOND_M + 1, 4.0)
    half = street.road_width_m / 2
    gutter = float(street.crown_height(np.array(half)))
    top = gutter + street.kerb_height_m
    back = half + street.pavement_width_m
    kerb = np.array([[half, gutter - 0.3], [half, top - 0.015], [half + 0.015, top], [half + 0.15, top]])
    pavement = np.array([[half + 0.15, top], [back, top + 0.03]])
    ground = np.array([[back, top + 0.03], [back + 1.7, top + 0.05], [150.0, top + 1.5]])
    wall = [[WALL_Y_M, -0.2], [WALL_Y_M, WALL_HEIGHT_M], [WALL_Y_M + 0.04, WALL_HEIGHT_M]]
    wall += [[WALL_Y_M + 0.04, WALL_HEIGHT_M + 0.07], [WALL_Y_M - WALL_THICKNESS_M - 0.04, WALL_HEIGHT_M + 0.07]]
    wall += [[WALL_Y_M - WALL_THICKNESS_M, -0.2]]
    parts = [Part(Surface.WALL, extruded(np.array(wall), xs))]
    for side in (np.array([1.0, 1.0]), np.array([-1.0, 1.0])):
        parts.append(Part(Surface.KERB, extruded(kerb * side, xs)))
        parts.append(Part(Surface.PAVEMENT, extruded(pavement * side, xs)))
        parts.append(Part(Surface.GROUND, extruded(ground * side, xs)))
    return parts


def _houses(street: Street, rng: np.random.Generator) -> list[Part]:
    """A row of houses on the left, and roofs that look over the wall on the right."""
    parts: list[Part] = []
    for side, setback in ((1.0, HOUSE_FRONT_M), (-1.0, 16.0)):
        x = -DRAWN_BEYOND_M
        while x < street.length_m + DRAWN_BEYOND_M:
            length, depth, floors = rng.uniform(8, 14), rng.uniform(8, 10), rng.integers(2, 4)
            middle = pose(x + length / 2, side * (setback + depth / 2 + rng.uniform(0, 0.8)), 0.0)
            parts += _house(middle, length, depth, 2.9 * floors + 0.5, PLASTERS[rng.integers(len(PLASTERS))])
            x += length + (rng.uniform(3, 9) if rng.random() < 0.35 or side < 0 else 0.02)
    return parts


def _house(
    street_from_house: FloatArray, length_m: float, depth_m: float, height_m: float, colour: Colour
) -> list[Part]:
    eaves, ridge = depth_m / 2 + 0.45, 0.28 * depth_m
    profile = np.array(
        [[-eaves, -0.25], [0.0, ridge], [eaves, -0.25], [eaves, -0.35], [0.0, ridge - 0.1], [-eaves, -0.35]]
    )
    roof = extruded(profile, np.array([-length_m / 2, length_m / 2])).moved(pose(0, 0, height_m))
    gable_ends = [
        grid(np.array([[[x, -depth_m / 2, -0.2], [x, 0, ridge - 0.1]], [[x, depth_m / 2, -0.2], [x, 0, ridge - 0.1]]]))
        for x in (-length_m / 2, length_m / 2)
    ]
    body = joined([box(length_m, depth_m, height_m), *(end.moved(pose(0, 0, height_m)) for end in gable_ends)])
    return [
        Part(Surface.BUILDING, body, street_from_house, colour),
        Part(Surface.ROOF, roof, street_from_house, (0.33, 0.12, 0.07)),
    ]


def _trees(street: Street, rng: np.random.Generator) -> list[Part]:
    """Trees behind the wall: their shadows reach the pavement, not the lane."""
    parts: list[Part] = []
    x = -60.0
    while x < street.length_m + DRAWN_BEYOND_M:
        at = pose(x, rng.uniform(-12.0, -9.2), 0.0, rng.uniform(0, 6))
        height = rng.uniform(3.0, 4.6)
        parts.append(Part(Surface.TRUNK, cylinder(0.17, height, 0.10, 10), at, (0.09, 0.065, 0.045)))
        parts.append(Part(Surface.TREE, _crown(rng, height), at, GREENS[rng.integers(len(GREENS))]))
        x += rng.uniform(9, 22)
    return parts


def _crown(rng: np.random.Generator, trunk_m: float) -> Mesh:
    """Tufts of leaves, each a square turned at random, in several balls about the top of the trunk."""
    balls = np.stack([rng.normal(0, 0.8, 9), rng.normal(0, 0.8, 9), trunk_m + rng.uniform(-0.4, 1.7, 9)], axis=1)
    radii = rng.uniform(0.7, 1.3, 9)
    ball = rng.integers(0, 9, TUFTS)
    outwards = rng.standard_normal((TUFTS, 3))
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    centre = balls[ball] + outwards * (radii[ball] * rng.uniform(0.55, 1.0, TUFTS))[:, None]
    edges = rng.normal(0, TUFT_HALF_M, (2, TUFTS, 1, 3))
    corners = centre[:, None] + np.concatenate([-edges[0], edges[1], edges[0], -edges[1]], axis=1)
    triangles = 4 * np.repeat(np.arange(TUFTS), 2)[:, None] + np.tile([[0, 1, 2], [0, 2, 3]], (TUFTS, 1))
    return Mesh(corners.reshape(-1, 3), triangles)


def _lamps(street: Street) -> list[Part]:
    """Street lamps on the left pavement."""
    parts = []
    y = street.road_width_m / 2 + 0.5
    for x in np.arange(-100.0, street.length_m + 100.0, 32.0):
        arm = cylinder(0.035, 1.6, sides=8).moved(pose(0, 0, 6.2, roll_rad=math.radians(80)))
        head = box(0.22, 0.55, 0.09).moved(pose(0, -1.7, 6.42))
        lamp = joined([cylinder(0.075, 6.25, 0.05, 12), arm, head])
        parts.append(Part(Surface.POLE, lamp, pose(x, y, 0.0), (0.10, 0.115, 0.11)))
    return parts


def _parked_cars(street: Street) -> list[Part]:
    parts = []
    for parked in street.parked_cars:
        place = pose(parked.x_m, parked.y_m, parked.z_m, parked.yaw_rad, roll_rad=parked.roll_rad)
        parts.append(Part(Surface.CAR, car.body(), place, parked.colour))
        parts.append(Part(Surface.WHEEL, car.wheels(), place, (0.02, 0.02, 0.02)))
    return parts


def _debris(terrain: Terrain) -> list[Part]:
    """Things on the road, standing on its surface."""
    parts = []
    for placed in terrain.street.obstacles:
        if isinstance(placed.shape, Debris) and not placed.filled:
            z = float(terrain.height_at(np.array([placed.x_m]), np.array([placed.y_m]))[0])
            slope = terrain.street.cross_slope(placed.y_m)
            lying = pose(placed.x_m, placed.y_m, z, roll_rad=math.atan(slope)) @ pose(0, 0, 0, placed.yaw_rad)
            parts.append(Part(Surface.DEBRIS, placed.shape.mesh, lying, (0.25, 0.175, 0.105), placed.obstacle_id))
    return parts


def _hills(rng: np.random.Generator) -> Part:
    """A ring of hills on the horizon."""
    azimuth = np.linspace(0, 2 * np.pi, 361)
    waves = sum(rng.uniform(5, 14) / k**0.5 * np.cos(k * azimuth + rng.uniform(0, 6)) for k in range(2, 16))
    ridge_m = np.maximum(52 + np.asarray(waves), 14)
    x, y = 160 + 1300 * np.cos(azimuth), 1300 * np.sin(azimuth)
    foot, top = np.stack([x * 0.6, y * 0.6, 0 * x - 4], -1), np.stack([x, y, ridge_m], -1)
    return Part(Surface.HILL, grid(np.stack([foot, top])), colour=(0.11, 0.15, 0.07))
