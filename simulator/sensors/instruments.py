"""The sensors of one vehicle at work: each answers, frame by frame, with its readings since the frame before."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from simulator.changes import Worlds
from simulator.motion import Carried, Motion
from simulator.readings import ImageReading, LidarReading, Reading
from simulator.recording.semantic_tags import semantic_tags
from simulator.sensors.camera import CameraModel
from simulator.sensors.gnss import GnssError, GnssReceiver
from simulator.sensors.imu import ImuModel, ImuUnit
from simulator.sensors.lidar import LidarModel
from simulator.sensors.sensor_config import RigSensor

FloatArray = NDArray[np.float64]

SEMANTIC_CAMERA = "sensor.camera.semantic_segmentation"

RAYS_A_SIDE = 2
"""On edges: four rays a pixel take half as long again as one everywhere, and no staircase is left."""


class Instrument(Protocol):
    """A sensor on its vehicle."""

    def read(self, frame: int) -> Iterator[Reading]:
        """The readings after the frame before and up to this one."""
        ...


@dataclass(frozen=True, slots=True)
class Carrier:
    """What carries the instruments: its motion, its number among the movers, and the world's step between frames."""

    motion: Motion
    mover: int
    tick_s: float
    worlds: Worlds


@dataclass(frozen=True, slots=True)
class Schedule:
    """When a sensor of its own period measures, in a world of ticks; a period of 0 means once a tick."""

    tick_s: float
    period_s: float

    def times(self, frame: int) -> FloatArray:
        """Moments (K,) after the frame before and up to this one."""
        period_s = self.period_s or self.tick_s
        first = math.floor((frame - 1) * self.tick_s / period_s + 1e-6) + 1
        last = math.floor(frame * self.tick_s / period_s + 1e-6)
        return np.asarray(np.arange(first, last + 1) * period_s, dtype=np.float64)


def instrument(sensor: RigSensor, carrier: Carrier, rng: np.random.Generator) -> Instrument:
    """The sensor at work on its carrier."""
    carried = Carried(carrier.motion, sensor.vehicle_from_sensor)
    schedule = Schedule(carrier.tick_s, sensor.tick_s)
    match sensor.model:
        case LidarModel() as model:
            return _Lidar(sensor, model, carried, carrier, schedule, rng)
        case CameraModel() as model:
            return _Camera(sensor, model, carrier, schedule)
        case ImuModel() as model:
            return _Imu(ImuUnit(model, carried, carrier.worlds.enu_from_street, rng, sensor.name), schedule)
        case gnss_error:  # a protocol: what is none of the classes above
            return _gnss(gnss_error, sensor, carried, carrier.worlds, schedule, rng)


@dataclass(frozen=True, slots=True)
class _Lidar:
    sensor: RigSensor
    model: LidarModel
    carried: Motion
    carrier: Carrier
    schedule: Schedule
    rng: np.random.Generator

    def read(self, frame: int) -> Iterator[Reading]:
        if self.schedule.times(frame).size:
            end_s = frame * self.carrier.tick_s
            world = self.carrier.worlds.at(end_s)
            sweep = world.sweep(self.model, self.carried, end_s, self.rng, self.carrier.mover)
            yield LidarReading(self.sensor.name, self.carried.poses(np.array([end_s]))[0], sweep)


@dataclass(frozen=True, slots=True)
class _Camera:
    sensor: RigSensor
    model: CameraModel
    carrier: Carrier
    schedule: Schedule

    def read(self, frame: int) -> Iterator[Reading]:
        if not self.schedule.times(frame).size:
            return
        time_s = frame * self.carrier.tick_s
        world = self.carrier.worlds.at(time_s)
        vehicle = self.carrier.motion.poses(np.array([time_s]))[0]
        if self.sensor.name.type == SEMANTIC_CAMERA:
            pixels = semantic_tags(world.segment(self.model, vehicle, time_s, self.carrier.mover))
        else:
            pixels = world.render(self.model, vehicle, RAYS_A_SIDE, time_s, self.carrier.mover)
        yield ImageReading(self.sensor.name, vehicle @ self.sensor.vehicle_from_sensor, pixels)


@dataclass(frozen=True, slots=True)
class _Gnss:
    receiver: GnssReceiver
    carried: Motion
    schedule: Schedule

    def read(self, frame: int) -> Iterator[Reading]:
        for time_s in self.schedule.times(frame):
            fix = self.receiver.measure(self.carried.poses(np.array([time_s]))[0], float(time_s))
            if fix is not None:
                yield fix


def _gnss(
    error: GnssError,
    sensor: RigSensor,
    carried: Motion,
    worlds: Worlds,
    schedule: Schedule,
    rng: np.random.Generator,
) -> _Gnss:
    receiver = GnssReceiver(error, worlds.georeference, worlds.enu_from_street, rng, sensor.name)
    return _Gnss(receiver, carried, schedule)


@dataclass(frozen=True, slots=True)
class _Imu:
    unit: ImuUnit
    schedule: Schedule

    def read(self, frame: int) -> Iterator[Reading]:
        times = self.schedule.times(frame)
        if times.size:
            yield from self.unit.measure(times)
