"""Short straight streets with obstacles of exactly known size, for passes of a simulated car."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from contract.geometry import Kind
from simulator.shapes.debris import Debris, DebrisKind, debris, random_debris
from simulator.shapes.hump import bump
from simulator.shapes.pothole import PotholeShape
from simulator.shapes.relief import Relief
from simulator.streets.road import straight_road
from simulator.streets.street import ParkedCar, PlacedObstacle, Roadside, Roughness, Street

TUNING_SEEDS = (1, 2, 3)
"""Streets on which constants of `outline` and `shape` in `detector.passes` were chosen; no figure comes from them."""

VERIFICATION_SEEDS = (101, 102)
"""Streets of the printed figures."""

BEYOND_M = 30.0
"""Of road drawn beyond both ends: farther than hits are accumulated."""

FIRST_M, SPACING_M = 24.0, 7.0
"""A window of hits is 3 m wide, and a thing's shadow ends before the next place."""

HOLES_PER_SIZE, BUMPS, RANDOM_HOLES = 3, 2, 8

HOLE_SIZES = {"S": (0.35, 0.30, 0.05), "M": (0.60, 0.45, 0.10), "L": (0.90, 0.70, 0.15)}
"""Length, width and depth in metres of the holes whose repeatability is stated."""

WALL_SHARE = (0.4, 1.2)
"""Width of a wall as a share of the depth: from steep, as of fresh holes, to 40 degrees."""

THINGS = (DebrisKind.CARTON, DebrisKind.ROCK, DebrisKind.PALLET)
LANE_MIDDLE_M, BESIDE_MIDDLE_M = 1.75, 0.9
ROUGHNESS = (Roughness.A, Roughness.B)
HIDING_CARS = 8
CAR_COLOUR = (0.32, 0.32, 0.33)

Shape = Relief | Debris


def passes_street(seed: int) -> Street:
    """Three holes of each of three sizes, two bumps, three things, in both lanes in random order, turned at random."""
    rng = np.random.default_rng([seed, 11])
    shapes = [*_holes(rng, seed), *_bumps(rng, seed), *_debris(rng, seed)]
    return _street(seed, _in_both_lanes(rng, shapes), ())


def random_street(seed: int) -> Street:
    """Obstacles of every size, as they come: eight holes without water, two bumps, three things."""
    rng = np.random.default_rng([seed, 16])
    shapes: list[tuple[Kind, Shape]] = [
        (Kind.POTHOLE, replace(PotholeShape.random(100 * seed + n), water=0.0).relief(100 * seed + n))
        for n in range(RANDOM_HOLES)
    ]
    shapes += [*_bumps(rng, seed), (Kind.DEBRIS, random_debris(100 * seed + 80)), *_debris(rng, seed)[:2]]
    return _street(seed, _in_both_lanes(rng, shapes), ())


def hiding_street(seed: int) -> Street:
    """Holes of all sizes in the right lane, each behind a car that stands there, seen from the left lane."""
    rng = np.random.default_rng([seed, 15])
    obstacles, cars = [], []
    for number in range(1, HIDING_CARS + 1):
        x, y = FIRST_M + SPACING_M * (number - 1), float(rng.uniform(-3.0, -2.4))
        size = list(HOLE_SIZES.values())[number % len(HOLE_SIZES)]
        shape = _hole(rng, size).relief(100 * seed + number)
        obstacles.append(PlacedObstacle(number, Kind.POTHOLE, x, y, float(rng.uniform(0.0, math.pi)), shape))
        beside, along = y + float(rng.uniform(1.3, 1.9)), x + float(rng.uniform(-1.5, 1.5))
        cars.append(ParkedCar(along, beside, -0.02 * abs(beside), 0.0, 0.0, CAR_COLOUR))
    return _street(seed, tuple(obstacles), tuple(cars))


def hole_size(placed: PlacedObstacle) -> str | None:
    """Name of the size in `HOLE_SIZES` of a hole of these streets."""
    for name, (length, _, _) in HOLE_SIZES.items():
        if placed.kind is Kind.POTHOLE and abs(placed.shape.length_m - length) < 0.02:
            return name
    return None


def _in_both_lanes(rng: np.random.Generator, shapes: list[tuple[Kind, Shape]]) -> tuple[PlacedObstacle, ...]:
    order = rng.permutation(len(shapes))
    return tuple(
        PlacedObstacle(
            number,
            shapes[index][0],
            FIRST_M + SPACING_M * (number - 1) + float(rng.uniform(-0.5, 0.5)),
            (-1) ** number * LANE_MIDDLE_M + float(rng.uniform(-BESIDE_MIDDLE_M, BESIDE_MIDDLE_M)),
            float(rng.uniform(0.0, math.pi)),
            shapes[index][1],
        )
        for number, index in enumerate(order, start=1)
    )


def _street(seed: int, obstacles: tuple[PlacedObstacle, ...], cars: tuple[ParkedCar, ...]) -> Street:
    return Street(
        seed,
        obstacles,
        cars,
        roads=(straight_road(2 * FIRST_M + SPACING_M * (len(obstacles) - 1), BEYOND_M),),
        roadsides=(Roadside.WALL, Roadside.WALL),
        roughness=ROUGHNESS[seed % len(ROUGHNESS)],
        yaw_rad=0.0,
    )


def _holes(rng: np.random.Generator, seed: int) -> list[tuple[Kind, Shape]]:
    sizes = list(HOLE_SIZES.values()) * HOLES_PER_SIZE
    return [(Kind.POTHOLE, _hole(rng, size).relief(100 * seed + number)) for number, size in enumerate(sizes)]


def _hole(rng: np.random.Generator, size: tuple[float, float, float]) -> PotholeShape:
    length, width, depth = size
    return PotholeShape(length, width, depth, wall_m=depth * float(rng.uniform(*WALL_SHARE)), rim_roughness_m=0.005)


def _bumps(rng: np.random.Generator, seed: int) -> list[tuple[Kind, Shape]]:
    sizes = [(rng.uniform(0.8, 1.4), rng.uniform(0.5, 0.8), rng.uniform(0.06, 0.10)) for _ in range(BUMPS)]
    return [(Kind.BUMP, bump(100 * seed + 50 + n, *map(float, size))) for n, size in enumerate(sizes)]


def _debris(rng: np.random.Generator, seed: int) -> list[tuple[Kind, Shape]]:
    sizes = [(rng.uniform(0.4, 0.8), rng.uniform(0.3, 0.5), rng.uniform(0.2, 0.35)) for _ in THINGS]
    return [
        (Kind.DEBRIS, debris(kind, 100 * seed + 70 + n, *map(float, size)))
        for n, (kind, size) in enumerate(zip(THINGS, sizes, strict=True))
    ]
