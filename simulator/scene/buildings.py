"""Rows of houses along a road."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.mesh import box, extruded, grid, joined, pose
from simulator.scene.ground import Clearance
from simulator.scene.scenery import Colour, Part, Surface
from simulator.streets.road import Road

FloatArray = NDArray[np.float64]

PLASTERS: tuple[Colour, ...] = (
    (0.46, 0.37, 0.24),
    (0.50, 0.47, 0.41),
    (0.38, 0.21, 0.14),
    (0.33, 0.37, 0.39),
    (0.52, 0.42, 0.22),
    (0.44, 0.29, 0.23),
    (0.24, 0.29, 0.24),
)
TILES: Colour = (0.33, 0.12, 0.07)
CELLAR_M = 1.2
"""Houses reach into the ground: on a slope no gap shows below them."""

NARROWEST_CURVE = 0.35
"""On the inside of a curve houses stand closer; farther in than this share of the radius none is built."""


def houses(
    road: Road, side: int, span_m: tuple[float, float], setback_m: float, clearance: Clearance, rng: np.random.Generator
) -> list[Part]:
    """Houses whose fronts stand `setback_m` from the edge, mostly wall to wall, where no road is in the way."""
    parts: list[Part] = []
    s = span_m[0]
    while s < span_m[1]:
        length, depth, floors = rng.uniform(8, 14), rng.uniform(8, 10), rng.integers(2, 4)
        back_off, gap = rng.uniform(0, 0.8), rng.uniform(3, 9) if rng.random() < 0.35 else 0.02
        colour = PLASTERS[rng.integers(len(PLASTERS))]
        t = side * (float(road.half_width(np.array([s]))[0]) + setback_m + depth / 2 + back_off)
        crowding = 1 - float(road.line.at(np.array([s])).curvature_per_m[0]) * t
        if crowding > NARROWEST_CURVE:
            along = (length + gap) / crowding
            place = standing(road, s + length / crowding / 2, t)
            if _free(place, length, depth, clearance):
                parts += _house(place, length, depth, 2.9 * floors + 0.5, colour)
        else:
            along = length
        s += along
    return parts


def standing(road: Road, s_m: float, t_m: float, turn_rad: float = 0.0) -> FloatArray:
    """(4, 4) pose of something beside the road, at its edge's height, x along the road."""
    s, t = np.array([s_m]), np.array([t_m])
    edge = float(road.half_width(s)[0])
    x, y = road.line.plan(s, t)[0]
    z = float(road.height(s, np.clip(t, -edge, edge))[0])
    return pose(x, y, z, float(road.line.at(s).heading_rad[0]) + turn_rad)


def _free(place: FloatArray, length_m: float, depth_m: float, clearance: Clearance) -> bool:
    corners = np.array([(x, y, 0.0, 1.0) for x in (-0.5, 0.0, 0.5) for y in (-0.5, 0.0, 0.5)])
    plan = (corners * np.array([length_m, depth_m, 1, 1])) @ place.T
    return bool((clearance.at(plan[:, :2])[0] > -0.3).all())


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
    walls = box(length_m, depth_m, height_m + CELLAR_M).moved(pose(0, 0, -CELLAR_M))
    body = joined([walls, *(end.moved(pose(0, 0, height_m)) for end in gable_ends)])
    return [
        Part(Surface.BUILDING, body, street_from_house, colour),
        Part(Surface.ROOF, roof, street_from_house, TILES),
    ]
