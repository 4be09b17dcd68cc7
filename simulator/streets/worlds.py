"""Streets from a seed: where they lead, what they are worn with, what stands and lies on them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from contract.geometry import LatLon
from simulator.streets.centreline import Centreline, alignment
from simulator.streets.course import Course, Stretch
from simulator.streets.placing import placed_obstacle, random_features, random_obstacle, random_parked_cars
from simulator.streets.road import Road, Section, side_road
from simulator.streets.street import DRAWN_BEYOND_M, GeoReference, PlacedObstacle, Roadside, Roughness, Street
from simulator.streets.trajectory import lane_path
from simulator.streets.world_plan import GENTLEST_RADIUS_M, WorldPlan

PLACES = (
    LatLon(latitude_deg=38.2466, longitude_deg=21.7346),
    LatLon(latitude_deg=52.5200, longitude_deg=13.4050),
    LatLon(latitude_deg=43.0481, longitude_deg=-76.1474),
    LatLon(latitude_deg=-33.8688, longitude_deg=151.2093),
    LatLon(latitude_deg=1.3521, longitude_deg=103.8198),
    LatLon(latitude_deg=64.1466, longitude_deg=-21.9426),
)
"""Patras, Berlin, Syracuse, Sydney, Singapore, Reykjavik: both hemispheres, the equator, high latitude."""

MOUTH_HALF_M, STRAIGHT_ENOUGH_PER_M = 15.0, 1 / 400
"""Side roads leave where the edge of the main road bends by less than 10 cm over their mouth."""

PARKED_BEYOND_M = 40.0
"""Cars are parked beyond both ends of what is driven: they are in sight."""


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
    obstacles = _obstacles(rng, plan, main, seed)
    features = random_features(rng, plan, [Stretch(main, 0.0, plan.length_m)], obstacles)
    beyond = Stretch(main, -PARKED_BEYOND_M, plan.length_m + PARKED_BEYOND_M)
    return replace(bare, obstacles=obstacles, features=features, parked_cars=random_parked_cars(rng, [beyond]))


def random_course(seed: int, plan: WorldPlan) -> Course:
    """The street of a seed, and its lanes: egos drive in the left one of those that lead along it."""
    street = random_street(seed, plan)
    lanes = street.main.section.lanes
    own = max(lane for lane, direction in enumerate(lanes) if direction > 0)
    order = [own, *(other for other in range(len(lanes)) if other != own)]
    paths = tuple(lane_path(street.main, lane) for lane in order)
    return Course(street, paths, DRAWN_BEYOND_M, (Stretch(street.main, 0.0, plan.length_m),))


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
    section, spacing = main.section, 100.0 / plan.obstacles_per_100m if plan.obstacles_per_100m else math.inf
    s = rng.uniform(0.3, 1.0) * spacing
    while s < plan.length_m:
        number = len(placed) + 1
        what = random_obstacle(rng, plan, section.lane_width_m, seed * 1_000 + number)
        lanes = [i for i, direction in enumerate(section.lanes) if direction > 0]
        lane = rng.choice(lanes) if rng.random() < 0.8 else rng.integers(len(section.lanes))
        place = (float(s), section.lane_offset_m(int(lane)))
        placed.append(placed_obstacle(rng, number, what, main.line, place, section.lane_width_m))
        s += spacing * float(rng.uniform(0.6, 1.4))
    return tuple(placed)
