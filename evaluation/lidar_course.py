"""Courses with known obstacles: a street from a seed, test obstacles in its lane, and a car that drives over it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.geometry import Kind
from detector.types import DetectorInput
from simulator.mesh import pose
from simulator.motion import Standing, rigid
from simulator.readings import Sweep
from simulator.sensors.beam import Beam
from simulator.sensors.lidar import LidarModel
from simulator.sensors.lidar_presets import hdl32e, hdl64e
from simulator.shapes.debris import Debris, DebrisKind, debris
from simulator.shapes.hump import bump
from simulator.shapes.pothole import pothole
from simulator.shapes.relief import Relief
from simulator.streets.placing import apart, placed_obstacle
from simulator.streets.street import DRAWN_BEYOND_M, PlacedObstacle, Roughness, Street
from simulator.streets.trajectory import Path, Sway, Trajectory, lane_path
from simulator.streets.world_plan import WorldPlan
from simulator.streets.worlds import random_street
from simulator.world import World

FloatArray = NDArray[np.float64]

LENGTH_M = 190.0
SPACING_M = 11.0
FIRST_M = 30.0
SPEED_MPS = 50.0 / 3.6
# Of a faster LiDAR's turns as many are processed as of a slow one's.
TURN_S = 0.1
# Odometry over the second that is accumulated: what repeats from pass to pass was measured with the same.
POSE_SD_M, POSE_SD_RAD = 0.01, math.radians(0.1)
# A point of the road is seen when nothing stands this much nearer on the line to it.
OCCLUSION_SLACK_M = 0.6


@dataclass(frozen=True, slots=True)
class Trial:
    """A kind and size of obstacle that the tables have a row for; sizes in metres."""

    name: str
    kind: Kind
    length_m: float
    width_m: float
    relief_m: float

    def shape(self, seed: int) -> Relief | Debris:
        """One of these, drawn from a seed."""
        sizes = self.length_m, self.width_m, self.relief_m
        if self.kind is Kind.POTHOLE:
            return pothole(seed, *sizes)
        return bump(seed, *sizes) if self.kind is Kind.BUMP else debris(DebrisKind.CARTON, seed, *sizes)


TRIALS = (
    Trial("hole 35 x 30 cm, 5 cm", Kind.POTHOLE, 0.35, 0.30, 0.05),
    Trial("hole 60 x 45 cm, 10 cm", Kind.POTHOLE, 0.60, 0.45, 0.10),
    Trial("hole 90 x 70 cm, 15 cm", Kind.POTHOLE, 0.90, 0.70, 0.15),
    Trial("bump 90 x 60 cm, 6 cm", Kind.BUMP, 0.90, 0.60, 0.06),
    Trial("bump 100 x 80 cm, 10 cm", Kind.BUMP, 1.00, 0.80, 0.10),
    Trial("box 40 x 30 cm, 25 cm", Kind.DEBRIS, 0.40, 0.30, 0.25),
)


@dataclass(frozen=True, slots=True)
class Course:
    """A world with a test obstacle every 11 m of the lane; `trials[i]` is what obstacle `i + 1` is one of."""

    world: World
    path: Path
    trials: tuple[Trial, ...]
    seed: int

    @property
    def obstacles(self) -> tuple[PlacedObstacle, ...]:
        """The test obstacles, in the order of driving."""
        return self.world.street.obstacles


@dataclass(frozen=True, slots=True)
class Moment:
    """One turn of the LiDAR: what the detector is given, the truth of each point, and of the pose."""

    sweep: DetectorInput
    truth: Sweep
    street_from_sensor: FloatArray


def presets(range_sd_m: float) -> dict[str, LidarModel]:
    """The sensors of the tables, their range noise set to one value; all have a beam's width, so mixed pixels too."""
    paper = replace(LidarModel(), beam=Beam(divergence_rad=0.002, echo_separation_m=0.75))
    slower = replace(paper, rate_hz=10.0)
    models = {"64 rings, 10 Hz": slower, "64 rings, 30 Hz": paper, "HDL-64E": hdl64e(), "HDL-32E": hdl32e()}
    return {name: replace(model, range_sd_m=range_sd_m) for name, model in models.items()}


def course(seed: int, roughness: Roughness) -> Course:
    """The course of a seed: curves down to 50 m, grades, crown, patches, manholes, joints and parked cars on it."""
    plan = WorldPlan(length_m=LENGTH_M, roughness=roughness, side_roads=False, obstacles_per_100m=0.0)
    street = random_street(seed, plan)
    rng = np.random.default_rng([seed, 41])
    lane = street.main.section.lanes.index(1)
    trials = [TRIALS[i] for i in rng.permutation(np.arange(int((LENGTH_M - FIRST_M) / SPACING_M)) % len(TRIALS))]
    obstacles = [
        _placed(rng, street, lane, FIRST_M + SPACING_M * k, k + 1, trial, seed) for k, trial in enumerate(trials)
    ]
    features = tuple(f for f in street.features if apart(f, obstacles))
    worn = replace(street, obstacles=tuple(obstacles), features=features)
    return Course(World(worn), lane_path(street.main, lane), tuple(trials), seed)


def _placed(
    rng: np.random.Generator, street: Street, lane: int, s_m: float, number: int, trial: Trial, seed: int
) -> PlacedObstacle:
    shape = trial.shape(seed * 100 + number)
    place = (s_m + float(rng.uniform(-2.0, 2.0)), street.main.section.lane_offset_m(lane))
    return placed_obstacle(rng, number, (trial.kind, shape), street.main.line, place, street.main.section.lane_width_m)


def drive(on: Course, lidar: LidarModel, seed: int, speed_mps: float = SPEED_MPS) -> Iterator[Moment]:
    """Ten turns of the LiDAR a second along the course; poses carry the error of odometry.

    Each turn is taken from one place: what a vehicle's motion within it does is the client's to undo.
    """
    rng = np.random.default_rng([seed, on.seed])
    times = np.linspace(0.0, LENGTH_M / speed_mps, 4)
    motion = Trajectory(on.path, times, DRAWN_BEYOND_M + speed_mps * times, Sway(), seed)
    for time_s in np.arange(0.0, times[-1], TURN_S):
        at = np.array([time_s])
        street_from_vehicle = motion.poses(at)[0]
        street_from_sensor = street_from_vehicle @ pose(0.0, 0.0, lidar.height_m)
        truth = on.world.sweep(lidar, Standing(street_from_sensor), time_s, rng)
        curvature = float(on.path.line.at(motion.distance(at)).curvature_per_m[0])
        measured = street_from_sensor @ _pose_error(rng)
        yield Moment(DetectorInput(truth.points_m, lidar.height_m, curvature, measured), truth, street_from_sensor)


def _pose_error(rng: np.random.Generator) -> FloatArray:
    position, angles = rng.normal(0.0, POSE_SD_M, 3), rng.normal(0.0, POSE_SD_RAD, 3)
    return np.asarray(rigid(position[None], angles[:1], angles[1:2], angles[2:])[0])


def in_sensor(street_from_sensor: FloatArray, on: Course) -> FloatArray:
    """Centres (K, 3) of the obstacles in the frame `sensor`."""
    x, y = (np.array([getattr(o, axis) for o in on.obstacles]) for axis in ("x_m", "y_m"))
    centres = np.stack([x, y, on.world.street.sound_height(x, y)], axis=1)
    return np.asarray((centres - street_from_sensor[:3, 3]) @ street_from_sensor[:3, :3])


def in_sight(street_from_sensor: FloatArray, on: Course) -> NDArray[np.bool_]:
    """Whether nothing stands between the sensor and the middle of each obstacle (K,)."""
    target = in_sensor(street_from_sensor, on)
    distance = np.linalg.norm(target, axis=1)
    rays = (target / distance[:, None]) @ street_from_sensor[:3, :3].T
    origin = street_from_sensor[:3, 3].astype(np.float32)
    hits = on.world.cast(np.broadcast_to(origin, rays.shape), rays.astype(np.float32))
    return np.asarray(
        hits.distance > distance - OCCLUSION_SLACK_M - 0.5 * np.array([o.shape.reach_m for o in on.obstacles])
    )
