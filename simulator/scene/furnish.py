"""A street with everything in and beside it, as parts."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from simulator.mesh import box, cylinder, joined, pose
from simulator.scene import car
from simulator.scene.buildings import houses, standing
from simulator.scene.ground import Clearance, hills, land
from simulator.scene.planting import trees
from simulator.scene.roadside import borders, wall
from simulator.scene.scenery import Part, Surface
from simulator.scene.terrain import Terrain
from simulator.shapes.debris import Debris
from simulator.streets.road import Road
from simulator.streets.street import Roadside, Street

HOUSE_SETBACK_M, SECOND_ROW_M = 3.7, 12.5
"""From the carriageway's edge: behind pavement and forecourt, and behind the trees of a walled side."""

TREE_SETBACK_M = (5.5, 8.5)
"""Their shadows reach the pavement, not the lane."""

LAMP_SPACING_M, LAMP_SETBACK_M, LAMP_MARGIN_M = 32.0, 0.5, 12.0
ZONE_M = (45.0, 110.0)
"""Length of one kind of roadside where they alternate."""


def furnish(terrain: Terrain) -> list[Part]:
    """Every part of the street except the roads' surfaces, seeded by the street."""
    street = terrain.street
    rng = np.random.default_rng([street.seed, 1])
    clearance = Clearance(street)
    parts = [part for road in street.roads for part in borders(road)]
    lined = [road for road in street.roads if not road.connecting]
    parts += [part for road in lined for part in _sides(street, road, clearance, rng)]
    parts += [part for road in lined for part in _lamps(road)]
    middle = street.main.line.at(np.array([street.main.line.start_m + street.main.line.length_m / 2])).position_m[0]
    return [*parts, *_parked_cars(street), *_debris(terrain), land(street, clearance), hills(rng, middle)]


def _sides(street: Street, road: Road, clearance: Clearance, rng: np.random.Generator) -> Iterator[Part]:
    for side, wanted in zip((1, -1), street.roadsides, strict=True):
        style = wanted if road.has_kerb(side) else Roadside.TREES
        s = road.line.start_m
        while s < road.line.end_m:
            end = road.line.end_m if style is not Roadside.MIXED else min(s + rng.uniform(*ZONE_M), road.line.end_m)
            chosen = style
            if style is Roadside.MIXED:
                chosen = (Roadside.HOUSES, Roadside.WALL, Roadside.TREES)[rng.integers(3)]
            yield from _zone(road, side, chosen, (s, end), clearance, rng)
            s = end


def _zone(
    road: Road,
    side: int,
    style: Roadside,
    span_m: tuple[float, float],
    clearance: Clearance,
    rng: np.random.Generator,
) -> list[Part]:
    if style is Roadside.HOUSES:
        return houses(road, side, span_m, HOUSE_SETBACK_M, clearance, rng)
    planted = trees(road, side, span_m, TREE_SETBACK_M, clearance, rng)
    if style is Roadside.TREES:
        return planted
    behind = houses(road, side, span_m, SECOND_ROW_M, clearance, rng)
    return [*wall(road, side, *span_m), *planted, *behind]


def _lamps(road: Road) -> list[Part]:
    """Street lamps on the left pavement, or on the right one where it is the only one."""
    sides = [side for side in (1, -1) if road.has_kerb(side)]
    return _lamps_beside(road, sides[0]) if sides else []


def _lamps_beside(road: Road, side: int) -> list[Part]:
    parts = []
    for s in np.arange(road.line.start_m + LAMP_MARGIN_M, road.line.end_m - LAMP_MARGIN_M, LAMP_SPACING_M):
        if any(o.side == side and o.start_m - 1 < s < o.end_m + 1 for o in road.openings):
            continue
        arm = cylinder(0.035, 1.6, sides=8).moved(pose(0, 0, 6.2, roll_rad=side * math.radians(80)))
        head = box(0.22, 0.55, 0.09).moved(pose(0, -1.7 * side, 6.42))
        lamp = joined([cylinder(0.075, 6.25, 0.05, 12), arm, head])
        place = standing(road, float(s), side * (float(road.half_width(np.array([s]))[0]) + LAMP_SETBACK_M))
        parts.append(Part(Surface.POLE, lamp, place, (0.10, 0.115, 0.11)))
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
            around = 0.1 * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
            z = terrain.height_at(placed.x_m + around[:, 0], placed.y_m + around[:, 1])
            pitch, roll = -math.atan2(z[1] - z[2], 0.2), math.atan2(z[3] - z[4], 0.2)
            lying = pose(placed.x_m, placed.y_m, float(z[0]), 0.0, pitch, roll) @ pose(0, 0, 0, placed.yaw_rad)
            parts.append(Part(Surface.DEBRIS, placed.shape.mesh, lying, placed.shape.colour, placed.obstacle_id))
    return parts
