"""Streets from a seed: where they lead, what they are worn with, what stands and lies on them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.geometry import Kind, LatLon
from simulator.centreline import Centreline, alignment
from simulator.debris import Debris, random_debris
from simulator.hump import HumpProfile, bump, speed_hump
from simulator.pothole import PotholeShape
from simulator.relief import Relief
from simulator.road import Road, Section, side_road
from simulator.road_features import joint, manhole, patch
from simulator.street import (
    DRAWN_BEYOND_M,
    Feature,
    GeoReference,
    ParkedCar,
    PlacedFeature,
    PlacedObstacle,
    Roadside,
    Roughness,
    Street,
)

FloatArray = NDArray[np.float64]
Shape = Relief | Debris

PLACES = (
    LatLon(latitude_deg=38.2466, longitude_deg=21.7346),
    LatLon(latitude_deg=52.5200, longitude_deg=13.4050),
    LatLon(latitude_deg=43.0481, longitude_deg=-76.1474),
    LatLon(latitude_deg=-33.8688, longitude_deg=151.2093),
    LatLon(latitude_deg=1.3521, longitude_deg=103.8198),
    LatLon(latitude_deg=64.1466, longitude_deg=-21.9426),
)
"""Patras, Berlin, Syracuse, Sydney, Singapore, Reykjavik: both hemispheres, the equator, high latitude."""

CAR_COLOURS = (
    (0.20, 0.018, 0.016),
    (0.045, 0.085, 0.16),
    (0.32, 0.32, 0.33),
    (0.03, 0.03, 0.035),
    (0.55, 0.55, 0.53),
    (0.05, 0.10, 0.06),
)

GENTLEST_RADIUS_M = 300.0
KINDS, KIND_SHARES = ("pothole", "bump", "hump", "debris"), (0.58, 0.14, 0.06, 0.22)
LANE_MARGIN_M = 0.15
MOUTH_HALF_M, STRAIGHT_ENOUGH_PER_M = 15.0, 1 / 400
"""Side roads leave where the edge of the main road bends by less than 10 cm over their mouth."""

MOUTH_MARGIN_M = 10.0
"""Nothing is parked this close to where a road joins."""


@dataclass(frozen=True, slots=True)
class WorldPlan:
    """What a random street may be like. `roughness` None draws a class; `scans` take the place of drawn potholes."""

    length_m: float = 500.0
    roughness: Roughness | None = None
    tightest_radius_m: float = 50.0
    steepest_grade: float = 0.05
    obstacles_per_100m: float = 3.5
    features_per_100m: float = 6.0
    side_roads: bool = True
    scans: tuple[Relief, ...] = ()

    def __post_init__(self) -> None:
        if not (60.0 <= self.length_m <= 5_000.0 and 30.0 <= self.tightest_radius_m <= GENTLEST_RADIUS_M):
            raise ValueError(f"a street is 60 to 5000 m long, its curves 30 to {GENTLEST_RADIUS_M:.0f} m wide")
        if not (0 <= self.steepest_grade <= 0.15 and 0 <= self.obstacles_per_100m <= 8 and self.features_per_100m >= 0):
            raise ValueError("a street climbs at most by 15 %, and carries at most 8 obstacles in 100 m")


def random_street(seed: int, plan: WorldPlan | None = None) -> Street:
    """The street of a seed; the same seed and plan give the same street."""
    plan = plan or WorldPlan()
    rng = np.random.default_rng([seed, 11])
    section = _section(rng)
    main, joining = _side_roads(rng, plan, Road(_line(rng, plan), section))
    roughness = plan.roughness or (Roughness.A, Roughness.B, Roughness.C)[rng.choice(3, p=(0.45, 0.35, 0.20))]
    place = PLACES[rng.integers(len(PLACES))]
    sides = [Roadside.MIXED, Roadside.HOUSES, Roadside.WALL, Roadside.TREES]
    bare = Street(
        seed,
        roads=(main, *joining),
        roadsides=(sides[rng.choice(4, p=(0.5, 0.3, 0.1, 0.1))], sides[rng.choice(4, p=(0.5, 0.2, 0.2, 0.1))]),
        roughness=roughness,
        yaw_rad=float(rng.uniform(-math.pi, math.pi)),
        origin_enu_m=(float(rng.uniform(-50, 50)), float(rng.uniform(-50, 50)), float(rng.uniform(-2, 2))),
        georeference=GeoReference(place, altitude_m=float(rng.uniform(5, 300))),
    )
    street = replace(bare, obstacles=_obstacles(rng, plan, main, seed))
    street = replace(street, features=_features(rng, plan, street))
    return replace(street, parked_cars=_parked(rng, street))


def _section(rng: np.random.Generator) -> Section:
    wide = rng.random() < 0.15
    return Section(
        lanes=(1, 1, -1, -1) if wide else (1, -1),
        lane_width_m=float(rng.uniform(3.2, 3.6)),
        crown_slope=float(rng.uniform(0.015, 0.03)),
        kerb_height_m=float(rng.uniform(0.08, 0.15)),
        pavement_width_m=float(rng.uniform(1.5, 2.6)),
    )


def _line(rng: np.random.Generator, plan: WorldPlan) -> Centreline:
    """Straights, clothoids and arcs that never turn back by more than 70 degrees, over rolling ground."""
    s, heading, end = -DRAWN_BEYOND_M, 0.0, plan.length_m + DRAWN_BEYOND_M
    curvature: list[tuple[float, float]] = [(s, 0.0)]
    while s < end:
        s += rng.uniform(30, 110)
        curvature.append((s, 0.0))
        # As many tight curves as wide ones: uniform in the curvature.
        bend = rng.uniform(1 / GENTLEST_RADIUS_M, 1 / plan.tightest_radius_m)
        room = math.radians(70) - abs(heading)
        towards = -np.sign(heading) if abs(heading) > math.radians(35) else rng.choice([-1.0, 1.0])
        turn = min(
            rng.uniform(math.radians(8), math.radians(55)),
            room + (2 * abs(heading) if towards != np.sign(heading) else 0),
        )
        easing = rng.uniform(12, 25)
        arc = max(turn / bend - easing, 1.0)
        for length, value in ((easing, bend), (arc, bend), (easing, 0.0)):
            s += length
            curvature.append((s, float(towards * value)))
        heading += towards * bend * (arc + easing)
    heights, z = [(-DRAWN_BEYOND_M, 0.0)], 0.0
    while heights[-1][0] < end:
        step = rng.uniform(70, 150)
        z += step * rng.uniform(-plan.steepest_grade, plan.steepest_grade)
        heights.append((heights[-1][0] + step, float(z)))
    curvature = [pair for pair in curvature if pair[0] < end] + [(end, 0.0)]
    return alignment(curvature, heights, start=(-DRAWN_BEYOND_M, 0.0, 0.0))


def _side_roads(rng: np.random.Generator, plan: WorldPlan, main: Road) -> tuple[Road, list[Road]]:
    """The main road with its openings, and the roads that join it, some of them facing each other."""
    joining: list[Road] = []
    s = rng.uniform(30, 120)
    while plan.side_roads and s < plan.length_m:
        around = main.line.at(np.linspace(s - MOUTH_HALF_M, s + MOUTH_HALF_M, 7)).curvature_per_m
        if np.abs(around).max() > STRAIGHT_ENOUGH_PER_M:
            s += 8.0
            continue
        sides = (1, -1) if rng.random() < 0.4 else (int(rng.choice([-1, 1])),)
        for side in sides:
            angle, grade = float(rng.uniform(-0.4, 0.4)), float(rng.uniform(-0.5, 0.5) * plan.steepest_grade)
            width = float(rng.uniform(2.8, 3.3))
            opened, road = side_road(
                main, s, side, angle, 140.0, grade, replace(main.section, lanes=(1, -1), lane_width_m=width)
            )
            if _clear_of(road, [main, *joining]):
                main = opened
                joining.append(road)
        s += rng.uniform(90, 220)
    return main, [replace(road, joins=main) for road in joining]


def _clear_of(road: Road, others: Sequence[Road]) -> bool:
    """Whether a side road, once out of its mouth, keeps 25 m from all others."""
    points = road.line.at(np.arange(road.line.start_m + 40.0, road.line.end_m, 5.0)).position_m[:, :2]
    return all(float(np.abs(other.line.project(points)[1]).min()) > 25.0 for other in others)


def _obstacles(rng: np.random.Generator, plan: WorldPlan, main: Road, seed: int) -> tuple[PlacedObstacle, ...]:
    placed: list[PlacedObstacle] = []
    spacing = 100.0 / plan.obstacles_per_100m if plan.obstacles_per_100m else math.inf
    s = rng.uniform(0.3, 1.0) * spacing
    while s < plan.length_m:
        number = len(placed) + 1
        kind, shape = _obstacle(rng, plan, main.section, seed * 1_000 + number)
        lanes = [i for i, direction in enumerate(main.section.lanes) if direction > 0]
        lane = rng.choice(lanes) if rng.random() < 0.8 else rng.integers(len(main.section.lanes))
        across = isinstance(shape, Relief) and shape.width_m > 2.0
        room = 0.0 if across else max(0.0, main.section.lane_width_m / 2 - _half_plan(shape) - LANE_MARGIN_M)
        t = main.section.lane_offset_m(int(lane)) + float(rng.uniform(-room, room))
        x, y = main.line.plan(np.array([s]), np.array([t]))[0]
        turn = 0.0 if across else float(rng.uniform(-0.6, 0.6))
        yaw = float(main.line.at(np.array([s])).heading_rad[0]) + turn
        placed.append(PlacedObstacle(number, kind, float(x), float(y), yaw, shape))
        s += spacing * float(rng.uniform(0.6, 1.4))
    return tuple(placed)


def _obstacle(rng: np.random.Generator, plan: WorldPlan, section: Section, seed: int) -> tuple[Kind, Shape]:
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
            return Kind.BUMP, speed_hump(profile, width_m=section.lane_width_m - 0.2)
        case _:
            return Kind.DEBRIS, random_debris(seed)


def _half_plan(shape: Shape) -> float:
    return math.hypot(shape.length_m, shape.width_m) / 2


def _features(rng: np.random.Generator, plan: WorldPlan, street: Street) -> tuple[PlacedFeature, ...]:
    """Patches, covers and joints of the main road, clear of the obstacles."""
    main = street.main
    features: list[PlacedFeature] = []
    for _ in range(round(plan.features_per_100m * plan.length_m / 100)):
        s = float(rng.uniform(0, plan.length_m))
        kind = (Feature.PATCH, Feature.MANHOLE, Feature.JOINT)[rng.choice(3, p=(0.5, 0.35, 0.15))]
        half = main.section.half_width_m
        match kind:
            case Feature.PATCH:
                length, width = float(rng.uniform(0.6, 4.0)), float(rng.uniform(0.5, 1.4))
                shape, t = patch(rng, length, width), float(rng.uniform(-half + width, half - width))
            case Feature.MANHOLE:
                shape, t = manhole(rng), float(rng.uniform(-half + 0.8, half - 0.8))
            case Feature.JOINT:
                shape, t = joint(2 * half - 0.1), 0.0
        x, y = main.line.plan(np.array([s]), np.array([t]))[0]
        yaw = float(main.line.at(np.array([s])).heading_rad[0])
        feature = PlacedFeature(kind, float(x), float(y), yaw, shape)
        if _apart(feature, [*street.obstacles, *features]):
            features.append(feature)
    return tuple(features)


def _apart(feature: PlacedFeature, others: Sequence[PlacedObstacle | PlacedFeature]) -> bool:
    return all(
        math.hypot(feature.x_m - other.x_m, feature.y_m - other.y_m) > feature.shape.reach_m + other.shape.reach_m
        for other in others
    )


def _parked(rng: np.random.Generator, street: Street) -> tuple[ParkedCar, ...]:
    """Cars with two wheels on the kerb, some touching distance apart, none where roads join."""
    main, cars = street.main, list[ParkedCar]()
    for side in (1, -1):
        s = float(rng.uniform(-40, 20))
        while s < street.length_m + 40:
            near = any(
                o.side == side and o.start_m - MOUTH_MARGIN_M < s < o.end_m + MOUTH_MARGIN_M for o in main.openings
            )
            curved = abs(float(main.line.at(np.array([s])).curvature_per_m[0])) > 1 / 80
            if not near and not curved:
                cars.append(_at_the_kerb(rng, main, s, side))
            s += 6.0 if rng.random() < 0.35 else float(rng.uniform(12, 70))
    return tuple(cars)


def _at_the_kerb(rng: np.random.Generator, road: Road, s_m: float, side: int) -> ParkedCar:
    s = np.array([s_m])
    edge = float(road.half_width(s)[0])
    x, y = road.line.plan(s, np.array([side * (edge + 0.55)]))[0]
    half_kerb = road.section.kerb_height_m / 2
    z = float(road.height(s, np.array([side * edge]))[0]) + half_kerb
    facing = 0.0 if side < 0 else math.pi
    yaw = float(road.line.at(s).heading_rad[0]) + facing
    # Its right wheels stand on the kerb: the height of the kerb over a track of 1.5 m.
    roll = -math.atan(road.section.kerb_height_m / 1.5)
    return ParkedCar(float(x), float(y), z, yaw, roll, CAR_COLOURS[rng.integers(len(CAR_COLOURS))])
