"""What a car would tell of the road behind it: whole drives that begin anywhere, and with sweeps that were dropped.

A simulated street knows what lies on it; on a recorded drive along a sound road all that is told is wrong.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from contract.geometry import LatLon
from detector.errors import DetectorError
from detector.pipeline import detect
from detector.types import DetectedObstacle, FrameDetection
from evaluation.lidar import in_place
from evaluation.lidar_course import Course, Moment, course, drive, in_sensor, presets
from simulator.streets.street import Roughness
from vehicle_client.drive import Measured, Step, Vehicle, detector_input
from vehicle_client.frames import GeoOrigin, inverse, rigid, yaw_of
from vehicle_client.link.nobody import NobodyLink
from vehicle_client.sensing.calibration import WHEELBASE_M, VehicleCalibration
from vehicle_client.sensing.calibration_file import CarCalibration
from vehicle_client.sensing.height_estimate import TRIED_FRAMES, estimated_height_m
from vehicle_client.sensing.preparation import Preparation
from vehicle_client.sources.frame import GnssFix, LidarFrame
from vehicle_client.sources.opening import SourceOptions, open_source

DROPPED = (0.0, 0.1, 0.3)
"""Shares of the sweeps that the simulated car does not get to see."""

LONGEST_BURST = 3
"""Sweeps dropped one after the other: what a processor that others need for a moment costs."""

RANGE_SD_M = 0.02
SENSORS = ("64 rings, 10 Hz", "HDL-64E", "HDL-32E")

LEAST_SWEEPS = 30
"""A recorded drive begins no later than so many sweeps before its end: something is to be passed yet."""


ORIGIN = GeoOrigin(LatLon(latitude_deg=49.0, longitude_deg=8.4), 115.0)
"""Where `odom` begins: satellites have no part in what is found, but without a place nothing is told."""


class Drive:
    """A car that tells nobody, and what it would have told; satellites tell it where its odometry has it."""

    def __init__(self, calibration: VehicleCalibration) -> None:
        self._vehicle = Vehicle(calibration, NobodyLink(), pseudonym="nobody")
        self._last: Step | None = None
        self._told: dict[int, DetectedObstacle] = {}

    def take(self, frame: LidarFrame, detection: FrameDetection) -> None:
        """The next sweep that is not dropped, and what `detect` finds in it."""
        self._last = self._vehicle.step(replace(frame, gnss=_fix(frame.odom_from_vehicle)), detection)
        self._add(self._last.measured)

    def end(self) -> list[DetectedObstacle]:
        """What it would have told, in `odom`, each track as it would have been told last."""
        if self._last is not None:
            self._add(self._vehicle.finish(self._last).measured)
        return list(self._told.values())

    def _add(self, measured: Sequence[Measured]) -> None:
        self._told |= {m.due.track.track_id: m.obstacle for m in measured if m.is_told}


def _fix(odom_from_vehicle: NDArray[np.float64] | None) -> GnssFix | None:
    if odom_from_vehicle is None:
        return None
    position, altitude_m = ORIGIN.geodetic(odom_from_vehicle[:3, 3])
    heading_rad = math.pi / 2 - yaw_of(odom_from_vehicle)
    return GnssFix(position, altitude_m, heading_rad, sd_m=0.5, altitude_sd_m=1.0)


def dropped(rng: np.random.Generator, sweeps: int, share: float) -> NDArray[np.bool_]:
    """Which of the sweeps (N,) are dropped: at least a share, in bursts."""
    gone = np.zeros(sweeps, dtype=np.bool_)
    while gone.sum() < share * sweeps:
        first = int(rng.integers(sweeps))
        gone[first : first + int(rng.integers(1, LONGEST_BURST + 1))] = True
    return gone


@dataclass(slots=True)
class Score:
    """Obstacles that were told and that were passed, by trial; what was told twice; what is not there, by kind."""

    told: Counter[str] = field(default_factory=Counter)
    passed: Counter[str] = field(default_factory=Counter)
    twice: int = 0
    false: Counter[str] = field(default_factory=Counter)
    metres: float = 0.0


Scores = Mapping[tuple[str, float], Score]
"""By sensor and the share of its sweeps that were dropped."""


def simulated(seeds: Sequence[int], sensors: Sequence[str] = SENSORS) -> Iterator[Scores]:
    """The scores so far, after each drive: every sensor along the street of every seed."""
    scores = {(sensor, share): Score() for sensor in sensors for share in DROPPED}
    for seed in seeds:
        on = course(seed, Roughness.B if seed % 2 else Roughness.C)
        for sensor in sensors:
            lidar = presets(RANGE_SD_M)[sensor]
            _score(scores, sensor, on, list(drive(on, lidar, seed)), np.random.default_rng([seed, 43]))
            yield scores


def _score(
    scores: Mapping[tuple[str, float], Score],
    sensor: str,
    on: Course,
    moments: Sequence[Moment],
    rng: np.random.Generator,
) -> None:
    height_m = float(moments[0].sweep.sensor_height_m or 0.0)
    calibration = VehicleCalibration(rigid(np.eye(3), np.array([0.0, 0.0, height_m])), "simulated")
    gone = {share: dropped(rng, len(moments), share) for share in DROPPED}
    cars = {share: Drive(calibration) for share in DROPPED}
    for number, moment in enumerate(moments):
        frame = _frame(moment, calibration, 0.1 * number)
        detection = detect(detector_input(frame, calibration))
        for share, car in cars.items():
            if not gone[share][number]:
                car.take(frame, detection)
    centres = np.array([[o.x_m, o.y_m, 0.0] for o in on.obstacles])
    behind = in_sensor(moments[-1].street_from_sensor, on)[:, 0] < 0.0
    for share, car in cars.items():
        score = scores[sensor, share]
        found = Counter[int | None]()
        for obstacle in car.end():
            which = in_place(obstacle, on, centres)
            found[which] += 1
            if which is None:
                score.false[obstacle.kind.value] += 1
        score.passed.update(trial.name for trial, is_behind in zip(on.trials, behind, strict=True) if is_behind)
        score.told.update(on.trials[k].name for k in found if k is not None and behind[k])
        score.twice += sum(times - 1 for k, times in found.items() if k is not None)
        places = np.array([m.street_from_sensor[:2, 3] for m in moments])
        score.metres += float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())


def _frame(moment: Moment, calibration: VehicleCalibration, stamp_s: float) -> LidarFrame:
    odom_from_sensor = moment.sweep.odom_from_sensor
    assert odom_from_sensor is not None  # noqa: S101  # of a course all sweeps have one
    return LidarFrame(
        stamp_s,
        moment.sweep.points_m,
        odom_from_vehicle=odom_from_sensor @ inverse(calibration.vehicle_from_sensor),
        steering_rad=math.atan(moment.sweep.curvature_per_m * WHEELBASE_M),
    )


@dataclass(frozen=True, slots=True)
class RecordedDrive:
    """A drive along a part of a recording: its first sweep, how many were dropped, and what was told, in `odom`."""

    first: int
    sweeps: int
    dropped: int
    told: tuple[DetectedObstacle, ...]


def sweeps_and_car(folder: Path) -> tuple[list[LidarFrame], CarCalibration]:
    """The sweeps of a recording, and a car that carries the sensor as high as they show.

    `SourceError` for what no source reads, `DetectorError` if no sweep shows a road.
    """
    frames = list(open_source(str(folder), SourceOptions()))
    height_m = estimated_height_m(frames[:TRIED_FRAMES])
    if height_m is None:
        raise DetectorError(f"{folder}: how high the LiDAR sits above the road cannot be told")
    place = rigid(np.eye(3), np.array([0.0, 0.0, height_m]))
    return frames, CarCalibration(VehicleCalibration(place, "recorded"))


def recorded(
    frames: Sequence[LidarFrame], car: CarCalibration, seeds: Sequence[int], share: float
) -> Iterator[RecordedDrive]:
    """A drive a seed along a recording without poses, each begun at another sweep, with other ones dropped."""
    found: dict[int, FrameDetection] = {}
    for seed in seeds:
        rng = np.random.default_rng([seed, 47])
        first = int(rng.integers(max(len(frames) - LEAST_SWEEPS, 1)))
        gone = dropped(rng, len(frames), share)
        preparation, drive_along = Preparation(car), Drive(car.vehicle)
        for number in range(first, len(frames)):
            if gone[number]:
                continue
            frame = preparation.prepared(frames[number])
            if number not in found:
                found[number] = detect(detector_input(frame, car.vehicle))
            drive_along.take(frame, found[number])
        preparation.close()
        told = tuple(drive_along.end())
        yield RecordedDrive(first, len(frames) - first, int(gone[first:].sum()), told)
