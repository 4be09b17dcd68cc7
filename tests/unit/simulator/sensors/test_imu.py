"""What an inertial unit feels of known motions."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import cumulative_trapezoid

from simulator.mesh import pose
from simulator.motion import Standing
from simulator.sensors.imu import GRAVITY_MPS2, ImuModel, ImuUnit, felt

ENU_FROM_STREET = pose(0, 0, 0, yaw_rad=math.radians(35))


@dataclass(frozen=True)
class Turning:
    """A circle to the left at constant speed, level."""

    radius_m: float
    speed_mps: float

    def poses(self, time_s: np.ndarray) -> np.ndarray:
        angle = time_s * self.speed_mps / self.radius_m
        return np.stack([pose(self.radius_m * math.sin(a), -self.radius_m * math.cos(a), 0, a) for a in angle])


@dataclass(frozen=True)
class Weaving:
    """Along x with changing speed, weaving and bobbing; it looks where it goes and rolls."""

    def poses(self, time_s: np.ndarray) -> np.ndarray:
        x, y, z = 8 * time_s + np.sin(time_s), 2 * np.sin(0.7 * time_s), 0.1 * np.sin(3 * time_s)
        yaw = np.arctan2(1.4 * np.cos(0.7 * time_s), 8 + np.cos(time_s))
        roll = 0.05 * np.sin(2 * time_s)
        return np.stack([pose(*at) for at in zip(x, y, z, yaw, 0 * yaw, roll, strict=True)])


@given(st.floats(-300, 300), st.floats(-3, 3))
def test_a_level_body_at_rest_feels_its_weight_only(x_m: float, yaw_rad: float) -> None:
    force, rate, heading = felt(Standing(pose(x_m, 2.0, 1.0, yaw_rad)), ENU_FROM_STREET, np.array([0.0, 5.0]))
    assert force == pytest.approx(np.tile([0, 0, 9.81], (2, 1)), abs=1e-6)
    assert rate == pytest.approx(np.zeros((2, 3)), abs=1e-9)
    east_of_forward = yaw_rad + math.radians(35)
    assert np.sin(heading) == pytest.approx(math.cos(east_of_forward) * np.ones(2), abs=1e-9)
    assert np.cos(heading) == pytest.approx(math.sin(east_of_forward) * np.ones(2), abs=1e-9)


def test_a_body_leaning_to_the_right_feels_its_weight_on_the_left() -> None:
    force, _, _ = felt(Standing(pose(0, 0, 0, roll_rad=0.1)), ENU_FROM_STREET, np.array([0.0]))
    assert force[0] == pytest.approx([0, 9.81 * math.sin(0.1), 9.81 * math.cos(0.1)], abs=1e-6)


@given(st.floats(5, 200), st.floats(1, 30))
def test_a_constant_turn_pulls_inwards_by_v_squared_over_r(radius_m: float, speed_mps: float) -> None:
    force, rate, _ = felt(Turning(radius_m, speed_mps), ENU_FROM_STREET, np.linspace(0, 3, 7))
    assert force == pytest.approx(np.tile([0, speed_mps**2 / radius_m, 9.81], (7, 1)), rel=1e-3, abs=1e-3)
    assert rate == pytest.approx(np.tile([0, 0, speed_mps / radius_m], (7, 1)), rel=1e-6, abs=1e-9)


def test_integrating_twice_gives_the_path_back() -> None:
    motion, time_s = Weaving(), np.linspace(0, 20, 4001)
    force, rate, _ = felt(motion, ENU_FROM_STREET, time_s)
    poses = motion.poses(time_s)
    acceleration = (poses[:, :3, :3] @ force[:, :, None])[:, :, 0] - [0, 0, GRAVITY_MPS2]
    start = (motion.poses(np.array([1e-3])) - motion.poses(np.array([-1e-3])))[0, :3, 3] / 2e-3
    velocity = start + cumulative_trapezoid(acceleration, time_s, axis=0, initial=0)
    position = poses[0, :3, 3] + cumulative_trapezoid(velocity, time_s, axis=0, initial=0)
    assert np.abs(position - poses[:, :3, 3]).max() < 0.02
    turn = np.eye(3)
    for omega in (rate[1:] + rate[:-1]) / 2:
        turn = turn @ _turned(omega * (time_s[1] - time_s[0]))
    assert poses[0, :3, :3] @ turn == pytest.approx(poses[-1, :3, :3], abs=1e-4)


def _turned(vector: np.ndarray) -> np.ndarray:
    """Rotation matrix of a small rotation vector, to second order."""
    x, y, z = vector
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + cross + cross @ cross / 2


def test_noise_and_bias_are_as_wide_as_stated() -> None:
    model = ImuModel((0.1, 0.2, 0.3), (0.01, 0.02, 0.03), (0.1, 0.0, -0.2))
    unit = ImuUnit(model, Standing(np.eye(4)), ENU_FROM_STREET, np.random.default_rng(1))
    readings = list(unit.measure(np.arange(8_000) / 100))
    force = np.array([reading.accelerometer_mps2 for reading in readings])
    rate = np.array([reading.gyroscope_radps for reading in readings])
    assert force.std(axis=0) == pytest.approx(model.accelerometer_sd_mps2, rel=0.04)
    assert force.mean(axis=0) == pytest.approx([0, 0, 9.81], abs=0.02)
    assert rate.std(axis=0) == pytest.approx(model.gyroscope_sd_radps, rel=0.04)
    assert rate.mean(axis=0) == pytest.approx(model.gyroscope_bias_radps, abs=0.002)
    again = list(ImuUnit(model, Standing(np.eye(4)), ENU_FROM_STREET, np.random.default_rng(1)).measure(np.arange(2.0)))
    assert [r.time_s for r in again] == [0.0, 1.0]
    assert np.array_equal(again[0].accelerometer_mps2[:1], readings[0].accelerometer_mps2[:1])


def test_impossible_units_are_refused() -> None:
    for fields in (
        {"accelerometer_sd_mps2": (0, 0, math.inf)},
        {"gyroscope_sd_radps": (0, -1, 0)},
        {"gyroscope_bias_radps": (math.nan, 0, 0)},
    ):
        with pytest.raises(ValueError, match="inertial unit"):
            ImuModel(**fields)  # type: ignore[arg-type]
