"""A drive of several vehicles, drawn from a seed: the street, who moves through it and when, and what changes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from simulator.changes import APPEARED, GROWN, REMOVED, Change, ChangingStreet
from simulator.maps.map_street import Convoy, MapFile, map_course
from simulator.painting.sky import Daylight, daylight
from simulator.scene import car
from simulator.scene.mover import Model, Mover
from simulator.scene.people import pedestrian
from simulator.scene.scenery import Part, Surface
from simulator.shapes.relief import Relief
from simulator.streets.course import BEHIND_M, MOST_EAGER, SPEED_LIMIT_MPS, Course, last_start_m
from simulator.streets.keeping_clear import RoadSpace
from simulator.streets.placing import CAR_COLOURS
from simulator.streets.street import PlacedObstacle, Street
from simulator.streets.traffic import CAR_LENGTH_M, Driver, follow
from simulator.streets.trajectory import STEADY, Path, Sway, Trajectory, pavement_path
from simulator.streets.world_plan import WorldPlan
from simulator.streets.worlds import random_course

FloatArray = NDArray[np.float64]

EGO_GAP_M = (55.0, 110.0)
"""From one ego to the next: out of each other's sight of small things, soon enough to be warned."""

CAR_GAP_M = (40.0, 160.0)
LEAST_GAP_M = 22.0
START_LATER_S = (0.5, 2.0)
WALK_MPS = (0.9, 1.6)
PEDESTRIANS_PER_100M = 3.0

CHANGE_SHARE = 0.35
"""Of the obstacles change between two egos' passes: what a map that lives is tested with."""
GROWTH = (1.2, 1.8)


@dataclass(frozen=True, slots=True)
class ScenarioPlan:
    """What is asked for; all else follows from the seed.

    `world.length_m` follows from the time that is driven; with a map the roads are the map's.
    """

    seed: int = 1
    egos: int = 2
    seconds: float = 20.0
    traffic: bool = True
    changes: bool = True
    world: WorldPlan = field(default_factory=WorldPlan)
    map_file: MapFile | None = None

    def __post_init__(self) -> None:
        if not (1 <= self.egos <= 8 and 0.1 <= self.seconds <= 300.0 and self.seed >= 0):
            raise ValueError("a scenario has 1 to 8 egos that drive 0.1 to 300 s, and a seed that is not negative")


@dataclass(frozen=True, slots=True, eq=False)
class Ego:
    """A recording vehicle: its motion, when its recording starts, and its number among the movers."""

    trajectory: Trajectory
    start_s: float
    mover: int


@dataclass(frozen=True, slots=True, eq=False)
class Scenario:
    """Everything that happens; times count from 0 of the world's clock."""

    plan: ScenarioPlan
    changing: ChangingStreet
    movers: tuple[Mover, ...]
    egos: tuple[Ego, ...]
    daylight: Daylight


def scenario(plan: ScenarioPlan) -> Scenario:
    """The scenario of a plan; the same plan gives the same one. `OpenDriveError` if its map cannot be driven."""
    rng = np.random.default_rng([plan.seed, 21])
    starts_s = np.concatenate([[0.0], np.cumsum(rng.uniform(*START_LATER_S, plan.egos - 1))])
    gaps = rng.uniform(*EGO_GAP_M, plan.egos - 1)
    behind = np.concatenate([[0.0], np.cumsum(gaps)])
    duration_s = float(starts_s[-1]) + plan.seconds
    course = _course(plan, Convoy(plan.egos, float(behind[-1]), plan.seconds, duration_s))
    street, egos_at = course.street, course.from_m + float(behind[-1]) + BEHIND_M - behind
    movers, trajectories = _cars(rng, plan, course, egos_at, duration_s)
    if plan.traffic:
        movers += _walkers(rng, course, len(movers), duration_s)
    egos = tuple(Ego(t, float(s), number) for number, (t, s) in enumerate(zip(trajectories, starts_s, strict=True), 1))
    changing = ChangingStreet(street, _changes(rng, plan, street, egos, duration_s))
    return Scenario(plan, changing, tuple(movers), egos, _light(rng))


def _course(plan: ScenarioPlan, convoy: Convoy) -> Course:
    if plan.map_file is not None:
        return map_course(plan.map_file.read(), plan.seed, plan.world, convoy)
    driven = SPEED_LIMIT_MPS * MOST_EAGER * convoy.duration_s
    return random_course(plan.seed, replace(plan.world, length_m=max(120.0, convoy.behind_m + driven + 60.0)))


def _cars(
    rng: np.random.Generator, plan: ScenarioPlan, course: Course, egos_at_m: FloatArray, duration_s: float
) -> tuple[list[Mover], list[Trajectory]]:
    """The egos, numbered from 1, then all other cars, lane by lane; who would touch another one stays away."""
    movers: list[Mover] = []
    egos: list[Trajectory] = []
    space = RoadSpace(course.street.parked_cars, duration_s)
    for path in course.lanes:
        own = [] if egos else list(egos_at_m)
        others = _starts(rng, path, duration_s, own) if plan.traffic else []
        drivers = [Driver(float(at), float(rng.uniform(0.92, 1.04))) for at in [*own, *others]]
        if not drivers:
            continue
        times, travelled = follow(path, drivers, SPEED_LIMIT_MPS, duration_s)
        for column in range(len(drivers)):
            number = len(movers) + 1
            trajectory = Trajectory(path, times, travelled[:, column], Sway(), plan.seed * 1_000 + number)
            model = _car(rng)
            if column < len(own):
                space.take(trajectory)
                egos.append(trajectory)
            elif not space.take_if_free(trajectory):
                continue
            movers.append(Mover(number, model, trajectory))
    return movers, egos


def _starts(rng: np.random.Generator, path: Path, duration_s: float, taken_m: list[float]) -> list[float]:
    """Where other cars of a lane start, so that none leaves the drawn road during the drive."""
    starts = []
    at = path.line.start_m + float(rng.uniform(5, 60))
    last = last_start_m(path, duration_s) - CAR_LENGTH_M
    while at < last:
        if all(abs(at - other) > LEAST_GAP_M for other in taken_m):
            starts.append(at)
        at += float(rng.uniform(*CAR_GAP_M))
    return starts


def _car(rng: np.random.Generator) -> Model:
    colour = CAR_COLOURS[rng.integers(len(CAR_COLOURS))]
    parts = (Part(Surface.CAR, car.body(), colour=colour), Part(Surface.WHEEL, car.wheels(), colour=(0.02, 0.02, 0.02)))
    return Model(parts, middle_m=0.7, radius_m=2.4)


def _walkers(rng: np.random.Generator, course: Course, taken: int, duration_s: float) -> list[Mover]:
    """People on the pavements, in both directions, who stay on theirs for the drive."""
    walkers: list[Mover] = []
    for stretch in course.stretches:
        road = stretch.road
        sides = [side for side in (-1, 1) if road.has_kerb(side)]
        for _ in range(round(PEDESTRIANS_PER_100M * (stretch.to_m - stretch.from_m) / 100) if sides else 0):
            side, direction = int(rng.choice(sides)), int(rng.choice([-1, 1]))
            path = pavement_path(road, side, float(rng.uniform(0.5, road.section.pavement_width_m - 0.3)), direction)
            speed = float(rng.uniform(*WALK_MPS))
            from_m, to_m = stretch.from_m - road.line.start_m, stretch.to_m - road.line.start_m
            first, last = (from_m, to_m) if direction > 0 else (road.line.length_m - to_m, road.line.length_m - from_m)
            start = float(rng.uniform(first, last))
            if start + speed * duration_s > path.line.end_m:
                continue
            times = np.array([0.0, 1.0, 2.0, 3.0])
            number = taken + len(walkers) + 1
            walk = Trajectory(path, times, start + speed * times, STEADY, number)
            walkers.append(Mover(number, pedestrian(course.street.seed * 1_000 + number), walk))
    return walkers


def _changes(
    rng: np.random.Generator, plan: ScenarioPlan, street: Street, egos: tuple[Ego, ...], duration_s: float
) -> tuple[Change, ...]:
    """Some obstacles change while no ego looks: halfway between the passes of two egos that follow each other."""
    changes: list[Change] = []
    times = np.arange(0.0, duration_s, 0.1)
    tracks = [ego.trajectory.poses(times)[:, :2, 3] for ego in egos]
    for placed in street.obstacles:
        draw, factor = rng.random(), float(rng.uniform(*GROWTH))
        pair = int(rng.integers(max(1, len(egos) - 1)))
        if not plan.changes or len(egos) < 2 or draw >= CHANGE_SHARE:
            continue
        first, second = (_passes(times, tracks[pair + i], placed) for i in (0, 1))
        if first is None or second is None:
            continue
        kinds = (GROWN, REMOVED, APPEARED) if isinstance(placed.shape, Relief) else (REMOVED, APPEARED)
        what = kinds[int(draw / CHANGE_SHARE * len(kinds))]
        changes.append(Change((first + second) / 2, placed.obstacle_id, what, factor if what == GROWN else 1.0))
    return tuple(sorted(changes, key=lambda change: change.time_s))


def _passes(times_s: FloatArray, track_m: FloatArray, placed: PlacedObstacle) -> float | None:
    """When a vehicle is nearest to an obstacle, None if it never passes it."""
    distance = np.hypot(track_m[:, 0] - placed.x_m, track_m[:, 1] - placed.y_m)
    nearest = int(distance.argmin())
    return float(times_s[nearest]) if distance[nearest] < 8.0 else None


def _light(rng: np.random.Generator) -> Daylight:
    cloudiness = float(rng.choice([0.0, 0.0, 0.3, 1.0]))
    return daylight(math.radians(float(rng.uniform(12, 65))), float(rng.uniform(-math.pi, math.pi)), cloudiness)
