"""What roads are worn with, and what lies and stands on them, drawn from a seed along the lanes of a street."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contract.geometry import Kind
from simulator.shapes.debris import Debris, random_debris
from simulator.shapes.hump import HumpProfile, bump, speed_hump
from simulator.shapes.pothole import PotholeShape
from simulator.shapes.relief import Relief
from simulator.streets.centreline import Centreline
from simulator.streets.course import Stretch
from simulator.streets.road import Road
from simulator.streets.road_features import joint, manhole, patch
from simulator.streets.street import Feature, ParkedCar, PlacedFeature, PlacedObstacle
from simulator.streets.world_plan import WorldPlan

FloatArray = NDArray[np.float64]
Shape = Relief | Debris

CAR_COLOURS = (
    (0.20, 0.018, 0.016),
    (0.045, 0.085, 0.16),
    (0.32, 0.32, 0.33),
    (0.03, 0.03, 0.035),
    (0.55, 0.55, 0.53),
    (0.05, 0.10, 0.06),
)

KINDS, KIND_SHARES = ("pothole", "bump", "hump", "debris"), (0.58, 0.14, 0.06, 0.22)
LANE_MARGIN_M = 0.15

ON_KERB_M, BAY_INSET_M, TRACK_M = 0.55, 1.1, 1.5
"""Middles of parked cars outside the edge, or inside that of a parking lane; between their left and right wheels."""

MOUTH_MARGIN_M = 10.0
"""Nothing is parked this close to where a road joins."""


def random_obstacle(rng: np.random.Generator, plan: WorldPlan, lane_width_m: float, seed: int) -> tuple[Kind, Shape]:
    """Something for a lane of that width: a pothole more often than a bump, a hump or debris."""
    match KINDS[rng.choice(len(KINDS), p=KIND_SHARES)]:
        case "pothole":
            if plan.scans:
                scan = plan.scans[rng.integers(len(plan.scans))]
                return Kind.POTHOLE, scan.grown(float(rng.uniform(0.4, 1.3)))
            shape = PotholeShape.random(seed)
            return Kind.POTHOLE, replace(shape, repaired=False).relief(seed)
        case "bump":
            sizes = rng.uniform(0.5, 1.6), rng.uniform(0.4, 1.0), rng.uniform(0.04, 0.10)
            return Kind.BUMP, bump(seed, *(float(size) for size in sizes))
        case "hump":
            profile = list(HumpProfile)[rng.integers(len(HumpProfile))]
            return Kind.BUMP, speed_hump(profile, width_m=lane_width_m - 0.2)
        case _:
            return Kind.DEBRIS, random_debris(seed)


def placed_obstacle(
    rng: np.random.Generator,
    number: int,
    what: tuple[Kind, Shape],
    line: Centreline,
    place: tuple[float, float],
    lane_width_m: float,
) -> PlacedObstacle:
    """Something within a lane whose middle lies at `place`, distance and offset along a line; humps lie across it."""
    kind, shape = what
    across = isinstance(shape, Relief) and shape.width_m > 2.0
    room = 0.0 if across else max(0.0, lane_width_m / 2 - _half_plan(shape) - LANE_MARGIN_M)
    s, t = np.array([place[0]]), np.array([place[1] + float(rng.uniform(-room, room))])
    x, y = line.plan(s, t)[0]
    turn = 0.0 if across else float(rng.uniform(-0.6, 0.6))
    yaw = float(line.at(s).heading_rad[0]) + turn
    return PlacedObstacle(number, kind, float(x), float(y), yaw, shape)


def _half_plan(shape: Shape) -> float:
    return math.hypot(shape.length_m, shape.width_m) / 2


def random_features(
    rng: np.random.Generator, plan: WorldPlan, stretches: Sequence[Stretch], obstacles: Sequence[PlacedObstacle]
) -> tuple[PlacedFeature, ...]:
    """Patches, covers and joints along stretches of road, clear of the obstacles."""
    features: list[PlacedFeature] = []
    for stretch in stretches:
        for _ in range(round(plan.features_per_100m * (stretch.to_m - stretch.from_m) / 100)):
            feature = _feature(rng, stretch.road, float(rng.uniform(stretch.from_m, stretch.to_m)))
            if apart(feature, [*obstacles, *features]):
                features.append(feature)
    return tuple(features)


def _feature(rng: np.random.Generator, road: Road, s_m: float) -> PlacedFeature:
    s = np.array([s_m])
    kind = (Feature.PATCH, Feature.MANHOLE, Feature.JOINT)[rng.choice(3, p=(0.5, 0.35, 0.15))]
    half = float(road.half_width(s)[0])
    match kind:
        case Feature.PATCH:
            length, width = float(rng.uniform(0.6, 4.0)), float(rng.uniform(0.5, 1.4))
            shape, room = patch(rng, length, width), half - width
        case Feature.MANHOLE:
            shape, room = manhole(rng), half - 0.8
        case Feature.JOINT:
            shape, room = joint(2 * half - 0.1), 0.0
    t = max(room, 0.0) * float(rng.uniform(-1, 1))
    x, y = road.line.plan(s, np.array([t]))[0]
    return PlacedFeature(kind, float(x), float(y), float(road.line.at(s).heading_rad[0]), shape)


def apart(one: PlacedObstacle | PlacedFeature, others: Sequence[PlacedObstacle | PlacedFeature]) -> bool:
    """Whether something touches none of the others."""
    return all(
        math.hypot(one.x_m - other.x_m, one.y_m - other.y_m) > one.shape.reach_m + other.shape.reach_m
        for other in others
    )


def random_parked_cars(rng: np.random.Generator, stretches: Sequence[Stretch]) -> tuple[ParkedCar, ...]:
    """Cars in parking lanes or with two wheels on the kerb, some touching distance apart, none where roads join."""
    cars: list[ParkedCar] = []
    for stretch in stretches:
        road = stretch.road
        for side in (1, -1):
            if not (road.has_kerb(side) or road.has_parking(side)):
                continue
            s = stretch.from_m + float(rng.uniform(0, 60))
            while s < stretch.to_m:
                near = any(
                    o.side == side and o.start_m - MOUTH_MARGIN_M < s < o.end_m + MOUTH_MARGIN_M for o in road.openings
                )
                curved = abs(float(road.line.at(np.array([s])).curvature_per_m[0])) > 1 / 80
                if not near and not curved:
                    cars.append(_parked(rng, road, s, side))
                s += 6.0 if rng.random() < 0.35 else float(rng.uniform(12, 70))
    return tuple(cars)


def _parked(rng: np.random.Generator, road: Road, s_m: float, side: int) -> ParkedCar:
    s = np.array([s_m])
    bay = road.has_parking(side)
    edge = float(road.half_width(s)[0])
    t = np.array([side * (edge + (-BAY_INSET_M if bay else ON_KERB_M))])
    x, y = road.line.plan(s, t)[0]
    direction = road.section.lanes[-1 if side > 0 else 0]
    yaw = float(road.line.at(s).heading_rad[0]) + (0.0 if direction > 0 else math.pi)
    kerb = 0.0 if bay else road.section.kerb_height_m
    rise = float(road.cross_slope(s, t)[0]) if bay else side * kerb / TRACK_M
    z = float(road.height(s, t if bay else np.array([side * edge]))[0]) + kerb / 2
    colour = CAR_COLOURS[rng.integers(len(CAR_COLOURS))]
    return ParkedCar(float(x), float(y), z, yaw, math.atan(direction * rise), colour)
