"""One vehicle's drive, frame by frame: the exact state, and what every sensor of its rig says of it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from simulator.changes import Worlds
from simulator.readings import EgoFrame
from simulator.scenario import Ego
from simulator.sensors.instruments import Carrier, instrument
from simulator.sensors.lidar import LidarModel
from simulator.sensors.odometry import Odometer, OdometryModel
from simulator.sensors.sensor_config import SensorRig

FloatArray = NDArray[np.float64]

DEFAULT_TICK_S = 1 / 30


def tick_of(rig: SensorRig) -> float:
    """Time between two frames: one turn of the first LiDAR; without one that of the paper's, 1/30 s."""
    rates = [sensor.model.rate_hz for sensor in rig.sensors if isinstance(sensor.model, LidarModel)]
    return 1 / rates[0] if rates else DEFAULT_TICK_S


def frame_numbers(ego: Ego, seconds: float, tick_s: float) -> range:
    """Ticks of the world's clock at which an ego has frames."""
    first = math.ceil(ego.start_s / tick_s - 1e-6)
    return range(first, first + max(0, math.floor(seconds / tick_s + 1e-6)))


class Drive:
    """The frames of one ego, in the order of time; each iteration yields the same.

    Frames of all vehicles count the same ticks of the world's clock. A reading belongs to the first frame at or after
    its own time; a LiDAR turn ends at its frame's time.
    """

    def __init__(
        self,
        worlds: Worlds,
        ego: Ego,
        rig: SensorRig,
        *,
        seed: int,
        seconds: float,
        tick_s: float | None = None,
        odometry: OdometryModel | None = None,
    ) -> None:
        self._worlds, self._ego, self._rig, self._seed = worlds, ego, rig, seed
        self._tick_s = tick_s or tick_of(rig)
        self._odometry = odometry or OdometryModel()
        self._numbers = frame_numbers(ego, seconds, self._tick_s)

    def __len__(self) -> int:
        return len(self._numbers)

    def __iter__(self) -> Iterator[EgoFrame]:
        odometer = Odometer(self._odometry, self._rng(0))
        carrier = Carrier(self._ego.trajectory, self._ego.mover, self._tick_s, self._worlds)
        instruments = [
            instrument(sensor, carrier, self._rng(index)) for index, sensor in enumerate(self._rig.sensors, start=1)
        ]
        for number in self._numbers:
            now = np.array([number * self._tick_s])
            street_from_vehicle = self._ego.trajectory.poses(now)[0]
            yield EgoFrame(
                number=number,
                time_s=float(now[0]),
                street_from_vehicle=street_from_vehicle,
                enu_from_vehicle=self._worlds.enu_from_street @ street_from_vehicle,
                odom_from_vehicle=odometer.measure(street_from_vehicle),
                speed_mps=float(self._ego.trajectory.speed(now)[0]),
                steering_rad=float(self._ego.trajectory.steering(now)[0]),
                readings=tuple(reading for one in instruments for reading in one.read(number)),
            )

    def _rng(self, stream: int) -> np.random.Generator:
        """A stream of its own for each sensor: one sensor more changes nothing for the others."""
        return np.random.default_rng([self._seed, self._ego.mover, stream])
