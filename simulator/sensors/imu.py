"""An inertial unit and compass: what they feel of a body's motion, at any times."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from simulator.motion import Motion
from simulator.readings import ImuReading, SensorName

FloatArray = NDArray[np.float64]
Axes = tuple[float, float, float]

IMU = SensorName("sensor.other.imu", "imu")

GRAVITY_MPS2 = 9.81
"""As in CARLA's inertial unit."""

STEP_S = 0.002
"""Half the span of central differences: truncation (a = 1 m/s^2 at 2 Hz: 5e-5) and rounding (1e-8) both vanish."""


@dataclass(frozen=True, slots=True)
class ImuModel:
    """White noise and constant bias of each axis, frame of the sensor; none by default, as in CARLA.

    CARLA's compass is exact; `compass_sd_rad` is ours.
    """

    accelerometer_sd_mps2: Axes = (0.0, 0.0, 0.0)
    gyroscope_sd_radps: Axes = (0.0, 0.0, 0.0)
    gyroscope_bias_radps: Axes = (0.0, 0.0, 0.0)
    compass_sd_rad: float = 0.0

    def __post_init__(self) -> None:
        deviations = (*self.accelerometer_sd_mps2, *self.gyroscope_sd_radps, self.compass_sd_rad)
        if not all(0 <= value < math.inf for value in deviations):
            raise ValueError("an inertial unit's deviations are not negative")
        if not all(map(math.isfinite, self.gyroscope_bias_radps)):
            raise ValueError("an inertial unit's bias is finite")


@dataclass(frozen=True, slots=True)
class ImuUnit:
    """A unit carried by `motion`, which gives the poses of the unit itself."""

    model: ImuModel
    motion: Motion
    enu_from_street: FloatArray
    rng: np.random.Generator
    sensor: SensorName = IMU

    def measure(self, times_s: FloatArray) -> Iterator[ImuReading]:
        """A reading for each of the times (N,)."""
        force, rate, heading = felt(self.motion, self.enu_from_street, times_s)
        force = force + self.rng.standard_normal(force.shape) * self.model.accelerometer_sd_mps2
        rate = rate + self.rng.standard_normal(rate.shape) * self.model.gyroscope_sd_radps
        rate += self.model.gyroscope_bias_radps
        heading = (heading + self.rng.standard_normal(heading.shape) * self.model.compass_sd_rad) % (2 * math.pi)
        for time_s, one_force, one_rate, one_heading in zip(times_s, force, rate, heading, strict=True):
            yield ImuReading(self.sensor, float(time_s), one_force, one_rate, float(one_heading))


def felt(motion: Motion, enu_from_street: FloatArray, times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Exact specific force (N, 3), angular rate (N, 3), both about the body's axes, and heading (N,) in [0, 2 pi).

    Specific force is acceleration minus gravity: a body at rest feels +9.81 m/s^2 upwards. Heading is clockwise from
    north.
    """
    before, now, after = (motion.poses(times_s + shift) for shift in (-STEP_S, 0.0, STEP_S))
    street_from_enu = enu_from_street[:3, :3].T
    acceleration = (before[:, :3, 3] - 2 * now[:, :3, 3] + after[:, :3, 3]) / STEP_S**2
    force = acceleration + street_from_enu @ np.array([0.0, 0.0, GRAVITY_MPS2])
    body_from_street = np.swapaxes(now[:, :3, :3], 1, 2)
    turned = Rotation.from_matrix(np.swapaxes(before[:, :3, :3], 1, 2) @ after[:, :3, :3]).as_rotvec()
    forward = now[:, :3, 0] @ street_from_enu
    heading = np.arctan2(forward[:, 0], forward[:, 1]) % (2 * math.pi)
    return (body_from_street @ force[:, :, None])[:, :, 0], turned / (2 * STEP_S), heading
