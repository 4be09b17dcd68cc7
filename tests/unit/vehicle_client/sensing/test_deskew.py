"""Points of a turning, driving sensor brought to one moment."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from vehicle_client.frames import Matrix, apply, inverse
from vehicle_client.sensing.deskew import LONGEST_STEP_S, Spin, Twist, deskew, twist_between

speeds = st.floats(-40, 40)
rates = st.floats(-1.5, 1.5)


def moved(twist: Twist, seconds: float) -> Matrix:
    """The screw motion by the matrix exponential, written anew."""
    x, y, z = twist.angular_rps
    generator = np.array([[0, -z, y, 0], [z, 0, -x, 0], [-y, x, 0, 0], [0, 0, 0, 0]], dtype=float)
    generator[:3, 3] = twist.velocity_mps
    return np.asarray(expm(generator * seconds))


@settings(max_examples=60, deadline=None)
@given(speeds, speeds, st.floats(-2, 2), rates, rates, rates, st.floats(0.01, LONGEST_STEP_S))
def test_the_motion_between_two_poses_leads_from_one_to_the_other(
    vx: float, vy: float, vz: float, wx: float, wy: float, wz: float, seconds: float
) -> None:
    twist = Twist(np.array([vx, vy, vz]), np.array([wx, wy, wz]))
    found = twist_between(moved(twist, seconds), seconds)
    assert found is not None
    assert found.velocity_mps == pytest.approx(twist.velocity_mps, abs=1e-6)
    assert found.angular_rps == pytest.approx(twist.angular_rps, abs=1e-6)
    assert found.now_from_then(-0.07) == pytest.approx(moved(twist, -0.07), abs=2e-5)


@settings(max_examples=25, deadline=None)
@given(speeds, rates, rates, st.integers(0, 100))
def test_a_standing_thing_is_seen_where_it_stands(speed: float, yaw_rate: float, roll_rate: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    twist = Twist(np.array([speed, 0.3, 0.0]), np.array([roll_rate, 0.0, yaw_rate]))
    things = random.uniform(-40, 40, (20, 3))
    times = random.uniform(-0.1, 0.02, 20).astype(np.float32)
    measured = [apply(inverse(moved(twist, float(t))), thing) for t, thing in zip(times, things, strict=True)]
    found = deskew(np.array(measured, dtype=np.float32), times, twist)
    assert found.dtype == np.float32
    assert np.abs(found - things).max() < 1e-4


def test_no_points_are_no_points_and_a_car_that_stands_changes_none() -> None:
    still = Twist(np.zeros(3), np.zeros(3))
    assert deskew(np.empty((0, 3), np.float32), np.empty(0, np.float32), still).shape == (0, 3)
    points = np.arange(12, dtype=np.float32).reshape(4, 3)
    assert deskew(points, np.full(4, -0.1, np.float32), still) == pytest.approx(points, abs=1e-6)


def test_a_time_that_is_no_number_leaves_its_point_and_the_others_move() -> None:
    points = np.ones((4, 3), dtype=np.float32)
    times = np.array([math.nan, math.inf, -0.1, -1e8], dtype=np.float32)
    found = deskew(points, times, Twist(np.array([10.0, 0, 0]), np.zeros(3)))
    assert found[:, 0] == pytest.approx([1, 1, 0, 1], abs=1e-6)


def test_as_many_times_as_points_are_asked_for() -> None:
    with pytest.raises(ValueError, match="5 points"):
        deskew(np.ones((5, 3), np.float32), np.zeros(4, np.float32), Twist(np.ones(3), np.ones(3)))


@pytest.mark.parametrize("seconds", [0.0, -0.1, LONGEST_STEP_S + 0.01, math.nan])
def test_between_poses_too_far_apart_no_motion_is_guessed(seconds: float) -> None:
    assert twist_between(np.eye(4), seconds) is None


def test_a_pose_that_is_not_finite_gives_no_motion() -> None:
    assert twist_between(np.full((4, 4), np.nan), 0.1) is None


@pytest.mark.parametrize(("clockwise", "first_deg"), [(True, 179.0), (False, -179.0)])
def test_a_spinning_sensor_s_azimuth_tells_the_time(clockwise: bool, first_deg: float) -> None:
    spin = Spin(rate_hz=10.0, clockwise=clockwise, end_azimuth_rad=math.pi)
    azimuth = np.radians([first_deg, 0.0, -first_deg])
    points = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(3)], axis=1).astype(np.float32)
    assert spin.point_time_s(points) == pytest.approx([-0.1 * 359 / 360, -0.05, -0.1 / 360], abs=1e-6)
