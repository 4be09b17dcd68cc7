"""Short straight streets with obstacles of exactly known size, for passes of a simulated car."""

from __future__ import annotations

import math

import numpy as np

from contract.geometry import Kind
from simulator.debris import Debris, DebrisKind, debris
from simulator.hump import bump
from simulator.pothole import PotholeShape
from simulator.relief import Relief
from simulator.road import straight_road
from simulator.street import PlacedObstacle, Roadside, Roughness, Street

TUNING_SEEDS = (1, 2, 3, 4)
"""Streets on which constants of `detector.shape` were chosen; no figure may come from them."""

VERIFICATION_SEEDS = (101, 102, 103, 104)
"""Streets of the printed figures."""

BEYOND_M = 30.0
"""Of road drawn beyond both ends: farther than hits are accumulated."""

FIRST_M, SPACING_M = 24.0, 7.0
"""A window of hits is 3 m wide, and a thing's shadow ends before the next place."""

HOLES_PER_SIZE, BUMPS, DEBRIS = 3, 2, 3

HOLE_SIZES = {"S": (0.35, 0.30, 0.05), "M": (0.60, 0.45, 0.10), "L": (0.90, 0.70, 0.15)}
"""Length, width and depth in metres of the holes whose repeatability is stated."""

WALL_SHARE = (0.4, 1.2)
"""Width of a wall as a share of the depth: from steep, as of fresh holes, to 40 degrees."""

LANE_MIDDLE_M, BESIDE_MIDDLE_M = 1.75, 0.9
ROUGHNESS = (Roughness.A, Roughness.B)


def passes_street(seed: int) -> Street:
    """Three holes of each of three sizes, bumps and debris, in both lanes in random order, turned at random."""
    rng = np.random.default_rng([seed, 11])
    shapes = [*_holes(rng, seed), *_bumps(rng, seed), *_debris(rng, seed)]
    order = rng.permutation(len(shapes))
    obstacles = tuple(
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
    return Street(
        seed,
        obstacles,
        roads=(straight_road(2 * FIRST_M + SPACING_M * (len(shapes) - 1), BEYOND_M),),
        roadsides=(Roadside.WALL, Roadside.WALL),
        roughness=ROUGHNESS[seed % len(ROUGHNESS)],
        yaw_rad=0.0,
    )


def hole_size(placed: PlacedObstacle) -> str | None:
    """Name of the size in `HOLE_SIZES` of a hole of a street of passes."""
    for name, (length, _, _) in HOLE_SIZES.items():
        if placed.kind is Kind.POTHOLE and abs(placed.shape.length_m - length) < 0.02:
            return name
    return None


def _holes(rng: np.random.Generator, seed: int) -> list[tuple[Kind, Relief | Debris]]:
    holes: list[tuple[Kind, Relief | Debris]] = []
    for number in range(HOLES_PER_SIZE * len(HOLE_SIZES)):
        length, width, depth = list(HOLE_SIZES.values())[number % len(HOLE_SIZES)]
        shape = PotholeShape(
            length, width, depth, wall_m=depth * float(rng.uniform(*WALL_SHARE)), rim_roughness_m=0.005
        )
        holes.append((Kind.POTHOLE, shape.relief(100 * seed + number)))
    return holes


def _bumps(rng: np.random.Generator, seed: int) -> list[tuple[Kind, Relief | Debris]]:
    sizes = [(rng.uniform(0.8, 1.4), rng.uniform(0.5, 0.8), rng.uniform(0.06, 0.10)) for _ in range(BUMPS)]
    return [(Kind.BUMP, bump(100 * seed + 50 + n, *map(float, size))) for n, size in enumerate(sizes)]


def _debris(rng: np.random.Generator, seed: int) -> list[tuple[Kind, Relief | Debris]]:
    kinds = (DebrisKind.CARTON, DebrisKind.ROCK, DebrisKind.PALLET)
    sizes = [(rng.uniform(0.4, 0.8), rng.uniform(0.3, 0.5), rng.uniform(0.2, 0.35)) for _ in range(DEBRIS)]
    return [
        (Kind.DEBRIS, debris(kinds[n % len(kinds)], 100 * seed + 70 + n, *map(float, size)))
        for n, size in enumerate(sizes)
    ]
