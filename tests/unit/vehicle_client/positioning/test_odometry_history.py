"""The bend that the car is on, from where odometry was."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.vehicle_client.making import NOON_S, planar
from vehicle_client.positioning.odometry_history import TIGHTEST_PER_M, OdometryHistory


def driven(speed_mps: float, curvature_per_m: float, *, seconds: float = 3.0, yaw_rad: float = 0.0) -> OdometryHistory:
    """Ten poses a second of a car on a circle; a negative speed is backwards."""
    history, x, y = OdometryHistory(), 0.0, 0.0
    for number in range(round(seconds * 10) + 1):
        history = history.with_pose(NOON_S + number / 10, planar(x, y, yaw_rad))
        turn = speed_mps / 10 * curvature_per_m
        x += speed_mps / 10 * math.cos(yaw_rad + turn / 2)
        y += speed_mps / 10 * math.sin(yaw_rad + turn / 2)
        yaw_rad += turn
    return history


@given(st.floats(2, 40) | st.floats(-10, -2), st.floats(-0.15, 0.15), st.floats(-math.pi, math.pi))
def test_a_car_on_a_circle_knows_its_curvature_forwards_and_backwards(
    speed_mps: float, curvature_per_m: float, yaw_rad: float
) -> None:
    turn_rad = abs(speed_mps / 10 * curvature_per_m)
    found = driven(speed_mps, curvature_per_m, yaw_rad=yaw_rad).curvature_per_m
    # A chord, seen along the axis that the car had at its begin, is shorter than its arc.
    assert found == pytest.approx(curvature_per_m, rel=turn_rad**2, abs=1e-9)


@given(st.floats(-0.6, 0.6), st.floats(-10, 10))
def test_of_a_car_that_hardly_moves_a_turn_is_noise(speed_mps: float, curvature_per_m: float) -> None:
    assert driven(speed_mps, curvature_per_m).curvature_per_m == 0.0


@given(st.floats(1, 5), st.floats(0.5, 3))
def test_no_bend_is_tighter_than_a_car_turns(speed_mps: float, curvature_per_m: float) -> None:
    assert abs(driven(speed_mps, curvature_per_m).curvature_per_m) <= TIGHTEST_PER_M


def test_before_the_second_pose_nothing_is_known() -> None:
    assert OdometryHistory().curvature_per_m == 0.0
    assert driven(10.0, 0.1, seconds=0.0).curvature_per_m == 0.0
