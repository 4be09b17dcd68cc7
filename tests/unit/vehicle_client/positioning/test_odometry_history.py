"""The bend that the car is on, from where odometry was."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.vehicle_client.making import NOON_S, planar
from vehicle_client.positioning.odometry_history import (
    BEND_WAY_M,
    UNSURE_SHARE,
    YAW_SD_RAD,
    OdometryHistory,
)
from vehicle_client.way_ahead import Bend


def driven(speed_mps: float, *curvatures_per_m: float, seconds: float = 3.0, yaw_rad: float = 0.0) -> OdometryHistory:
    """Ten poses a second of a car on one circle after the other, each for so long; a negative speed is backwards."""
    history, x, y = OdometryHistory().with_pose(NOON_S, planar(0.0, 0.0, yaw_rad)), 0.0, 0.0
    turns = [speed_mps / 10 * curvature for curvature in curvatures_per_m for _ in range(round(seconds * 10))]
    for number, turn in enumerate(turns, start=1):
        x += speed_mps / 10 * math.cos(yaw_rad + turn / 2)
        y += speed_mps / 10 * math.sin(yaw_rad + turn / 2)
        yaw_rad += turn
        history = history.with_pose(NOON_S + number / 10, planar(x, y, yaw_rad))
    return history


@given(st.floats(2.5, 40) | st.floats(-10, -2.5), st.floats(-0.15, 0.15), st.floats(-math.pi, math.pi))
def test_a_car_on_a_circle_knows_its_curvature_forwards_and_backwards(
    speed_mps: float, curvature_per_m: float, yaw_rad: float
) -> None:
    turn_rad = abs(speed_mps / 10 * curvature_per_m)
    bend = driven(speed_mps, curvature_per_m, yaw_rad=yaw_rad).bend
    # A chord, seen along the axis that the car had at its begin, is shorter than its arc.
    assert bend.curvature_per_m == pytest.approx(curvature_per_m, rel=turn_rad**2, abs=1e-9)
    # The noise of a yaw at either end, half a second and 3 m at least from each other; and no bend is for ever.
    measured_m = max(BEND_WAY_M, abs(speed_mps) * 0.5)
    ends_per_m = UNSURE_SHARE * abs(curvature_per_m)
    assert math.hypot(YAW_SD_RAD * 1.3 / (measured_m + 0.2 * abs(speed_mps)), ends_per_m * 0.95) < bend.sd_per_m
    assert bend.sd_per_m < math.hypot(YAW_SD_RAD * 1.5 / measured_m, ends_per_m * 1.05)


@given(st.floats(0.1, 40) | st.floats(-10, -0.1), st.floats(-0.1, 0.1), st.floats(-math.pi, math.pi))
def test_the_speed_of_a_car_that_backs_is_below_0(speed_mps: float, curvature_per_m: float, yaw_rad: float) -> None:
    assert driven(speed_mps, curvature_per_m, yaw_rad=yaw_rad).speed_mps == pytest.approx(speed_mps, rel=1e-6)


@given(st.floats(-1.8, 1.8), st.floats(-10, 10))
def test_of_a_car_that_hardly_moves_a_turn_is_noise(speed_mps: float, curvature_per_m: float) -> None:
    assert driven(speed_mps, curvature_per_m).bend == Bend()


@given(st.floats(5, 10), st.floats(0.3, 1) | st.floats(-1, -0.3))
def test_no_bend_is_tighter_than_a_car_turns(speed_mps: float, curvature_per_m: float) -> None:
    turned = driven(speed_mps, curvature_per_m).bend.curvature_per_m
    assert turned == 0.0 or turned == math.copysign(0.2, curvature_per_m)


def test_half_a_second_after_a_bend_the_way_is_straight_and_said_to_be_changing() -> None:
    bend = driven(10.0, 0.02, 0.0, seconds=0.5).bend
    assert bend.curvature_per_m == pytest.approx(0.0, abs=1e-6)
    assert bend.sd_per_m == pytest.approx(0.005, rel=0.01)
    assert driven(10.0, 0.02, 0.0).bend.sd_per_m < 0.001


def test_before_the_second_pose_nothing_is_known() -> None:
    assert OdometryHistory().bend == driven(10.0).bend == Bend()
    assert OdometryHistory().speed_mps == driven(10.0).speed_mps == 0.0


def test_after_a_gap_the_last_step_tells_the_bend() -> None:
    history = driven(10.0, 0.0, seconds=0.5)
    end = history.poses[-1]
    history = history.with_pose(end.stamp_s + 0.8, planar(float(end.place_m[0]) + 8.0, 0.0, 0.16))
    assert history.bend.curvature_per_m == pytest.approx(0.02)


def test_a_hundred_poses_a_second_are_measured_over_as_long() -> None:
    rng, history = np.random.default_rng(1), OdometryHistory()
    for number in range(300):
        history = history.with_pose(NOON_S + number / 100, planar(number * 0.14, 0.0, rng.normal(0.0, YAW_SD_RAD)))
    assert abs(history.bend.curvature_per_m) < 4 * YAW_SD_RAD / 7.0
