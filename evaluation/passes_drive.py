"""One pass of a simulated car along a street: sweeps, `detect`, the accumulator, and the hits around each place."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from contract.geometry import Kind
from detector.passes.accumulator import Accumulator, PlaceHits, accumulate, hits_around
from detector.passes.inspection import KnownPlace
from detector.pipeline import detect
from detector.types import DetectorInput
from evaluation.passes_street import HOLE_SIZES
from simulator.mesh import pose
from simulator.motion import Carried, rigid
from simulator.readings import Sweep
from simulator.sensors.lidar import LidarModel
from simulator.sensors.lidar_presets import carla_default, hdl64e
from simulator.streets.street import PlacedObstacle
from simulator.streets.trajectory import Sway, Trajectory, path_beside
from simulator.world import World

FloatArray = NDArray[np.float64]

SENSORS: dict[str, Callable[[], LidarModel]] = {"hdl64": hdl64e, "paper": LidarModel, "carla": carla_default}
SPEEDS_KMH = (30.0, 50.0)
LANE_OFFSET_M = 1.75

FRAME_S = 0.1
"""Of a LiDAR's turns ten a second are processed, as by the vehicle."""

POSE_NOISE_M, POSE_NOISE_RAD = 0.01, math.radians(0.1)
"""Of each sweep's pose in `odom`, 1 sigma per axis."""

PLACE_SD_M = 0.07
"""Of a known place relative to the car, 1 sigma per axis, and how far a track's estimate is off."""

LEAD_IN_M, PASSED_M = 16.0, 14.0
"""A drive begins before the first place by more than a hit's greatest range, and ends as far behind the last."""


@dataclass(frozen=True, slots=True)
class Pass:
    """A drive along a street: `direction` is 1 along x in the right lane, -1 against it in the left one."""

    sensor: str
    speed_kmh: float
    direction: int
    beside_m: float
    seed: int


@dataclass(frozen=True, slots=True)
class Look:
    """What one pass saw of one place: hits to measure from and hits to inspect with, `street` the street's seed.

    `placed` is what lies there, None for a place where nothing ever was.
    """

    street: int
    drive: Pass
    placed: PlacedObstacle | None
    known: KnownPlace
    hits: PlaceHits
    inspected: PlaceHits


def plan_passes(seed: int, sensors: tuple[str, ...], speeds_kmh: tuple[float, ...] = SPEEDS_KMH) -> list[Pass]:
    """For each sensor and speed two passes a direction, a little to either side of the lane's middle."""
    rng = np.random.default_rng([seed, 12])
    return [
        Pass(sensor, speed, direction, side * float(rng.uniform(0.1, 0.4)), int(rng.integers(1 << 31)))
        for sensor in sensors
        for speed in speeds_kmh
        for direction in (1, -1)
        for side in (1, -1)
    ]


def looks_of_pass(world: World, drive: Pass) -> Iterator[Look]:
    """A look at each obstacle of the street, and at sound road between them, when it lies `PASSED_M` behind."""
    rng = np.random.default_rng([drive.seed, 13])
    obstacles = world.street.obstacles
    places = [*((placed, _known(placed, rng)) for placed in obstacles), *_sound_places(obstacles, rng)]
    waiting = sorted(places, key=lambda place: drive.direction * float(place[1].centre_odom_m[0]))
    for along_m, state in accumulated(world, drive):
        while waiting and along_m > drive.direction * waiting[0][1].centre_odom_m[0] + PASSED_M:
            placed, known = waiting.pop(0)
            centre = known.centre_odom_m[:2]
            inspected = hits_around(state, centre, known.half_size_m)
            yield Look(world.street.seed, drive, placed, known, hits_around(state, centre), inspected)


def _known(placed: PlacedObstacle, rng: np.random.Generator) -> KnownPlace:
    """An obstacle as a server would know it: its size right, its place off by the place's standard deviation."""
    centre = np.array([placed.x_m, placed.y_m, 0.0]) + np.array([*rng.normal(0.0, PLACE_SD_M, 2), 0.0])
    sides = placed.shape.length_m, placed.shape.width_m
    is_hole = placed.kind is Kind.POTHOLE
    return KnownPlace(centre, *sides, placed.yaw_rad % math.pi, placed.shape.relief_m, is_hole, PLACE_SD_M)


def _sound_places(
    obstacles: tuple[PlacedObstacle, ...], rng: np.random.Generator
) -> list[tuple[PlacedObstacle | None, KnownPlace]]:
    """Half-way between neighbours, in the lane of the first, where a hole of one of the sizes would be known."""
    places: list[tuple[PlacedObstacle | None, KnownPlace]] = []
    for number, (one, other) in enumerate(pairwise(obstacles)):
        length, width, depth = list(HOLE_SIZES.values())[number % len(HOLE_SIZES)]
        centre = np.array([(one.x_m + other.x_m) / 2.0, one.y_m, 0.0])
        places.append(
            (None, KnownPlace(centre, length, width, float(rng.uniform(0, math.pi)), depth, True, PLACE_SD_M))
        )
    return places


def accumulated(world: World, drive: Pass) -> Iterator[tuple[float, Accumulator]]:
    """Position along the drive's direction and the accumulator after each sweep; `odom` is the frame `street`."""
    rng = np.random.default_rng([drive.seed, 14])
    lidar = SENSORS[drive.sensor]()
    trajectory = _trajectory(world, drive)
    sensor = Carried(trajectory, pose(0.0, 0.0, lidar.height_m))
    state = Accumulator()
    places = [drive.direction * placed.x_m for placed in world.street.obstacles]
    seconds = (max(places) - min(places) + LEAD_IN_M + PASSED_M) / (drive.speed_kmh / 3.6) + 2 * FRAME_S
    for time_s in np.arange(0.0, seconds, FRAME_S):
        sweep = world.sweep(lidar, sensor, float(time_s), rng)
        at_end = sensor.poses(np.array([time_s]))[0]
        reported = _disturbed(at_end, rng)
        taken = DetectorInput(_at_one_moment(sweep, sensor, float(time_s)), lidar.height_m, odom_from_sensor=reported)
        state = accumulate(state, taken, detect(taken))
        yield drive.direction * float(at_end[0, 3]), state


def _trajectory(world: World, drive: Pass) -> Trajectory:
    road, speed = world.street.main, drive.speed_kmh / 3.6
    path = path_beside(road, -drive.direction * LANE_OFFSET_M + drive.beside_m, drive.direction)
    first = min(drive.direction * placed.x_m for placed in world.street.obstacles) - LEAD_IN_M
    start = first - (road.line.start_m if drive.direction > 0 else -road.line.end_m)
    times = np.linspace(0.0, 1.0, 4)
    return Trajectory(path, times, start + speed * times, Sway(), drive.seed)


def _at_one_moment(sweep: Sweep, sensor: Carried, end_s: float) -> NDArray[np.float32]:
    """Points (N, 3) of a rolling turn in the sensor's frame at its end, by the motion since each was fired."""
    if not sweep.time_offset_s.any():
        return sweep.points_m
    moments, which = np.unique(sweep.time_offset_s, return_inverse=True)
    end_from_moment = np.linalg.inv(sensor.poses(np.array([end_s]))[0]) @ sensor.poses(
        np.asarray(end_s + moments, dtype=np.float64)
    )
    turned = np.einsum("nij,nj->ni", end_from_moment[which, :3, :3], sweep.points_m.astype(np.float64))
    return np.asarray(turned + end_from_moment[which, :3, 3], dtype=np.float32)


def _disturbed(odom_from_sensor: FloatArray, rng: np.random.Generator) -> FloatArray:
    shift, (yaw, pitch, roll) = rng.normal(0.0, POSE_NOISE_M, 3), rng.normal(0.0, POSE_NOISE_RAD, 3)
    turn = rigid(np.zeros((1, 3)), np.array([yaw]), np.array([pitch]), np.array([roll]))[0]
    disturbed = odom_from_sensor @ turn
    disturbed[:3, 3] += shift
    return np.asarray(disturbed)
