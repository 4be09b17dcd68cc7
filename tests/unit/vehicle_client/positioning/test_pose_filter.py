"""The bank of filters: what it learns of odometry and receivers, and how it stays a covariance."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.vehicle_client.making import NOON_S, ORIGIN, planar
from vehicle_client.frames import Vector
from vehicle_client.positioning import pose_filter
from vehicle_client.positioning.odometry_history import OdometryHistory
from vehicle_client.positioning.pose import PoseFilter, update
from vehicle_client.positioning.pose_filter import (
    DELAY,
    DELAY_SD_S,
    ERROR_MODELS,
    SCALE,
    YAW,
    PlaceMeasurement,
    PlaneFilter,
    advanced,
    expectation,
    started,
    with_place,
    with_yaw,
)
from vehicle_client.positioning.speed_scale import measured_scale
from vehicle_client.sources.frame import GnssFix, LidarFrame

NOWHERE = np.zeros(2)
NO_POINTS = np.empty((0, 3), dtype=np.float32)


def fix_of(east_m: float, north_m: float, sd_m: float = 1.0, *, speed_mps: float = 0.0) -> PlaceMeasurement:
    return PlaceMeasurement(np.array([east_m, north_m]), sd_m, NOWHERE, NOWHERE, np.array([speed_mps, 0.0]))


def after_fix(bank: PlaneFilter, fix: PlaceMeasurement) -> PlaneFilter:
    return with_place(bank, expectation(bank, fix), 0.1)


steps = st.lists(
    st.tuples(st.floats(-2, 3), st.floats(-0.2, 0.2), st.floats(-0.1, 0.1), st.floats(-5, 5), st.floats(0.05, 20)),
    min_size=1,
    max_size=30,
)


@settings(max_examples=40)
@given(steps)
def test_whatever_comes_the_covariances_stay_covariances_and_the_weights_sum_to_one(
    drive: list[tuple[float, float, float, float, float]],
) -> None:
    bank = started(fix_of(0, 0), 0.3, 0.05)
    for ahead, left, turn, east, sd in drive:
        bank = advanced(bank, np.array([ahead, left]), turn, 0.1)
        bank = with_yaw(after_fix(bank, fix_of(east, -east, sd)), turn, 0.1)
    assert np.isfinite(bank.mean).all()
    assert np.allclose(bank.covariance, bank.covariance.transpose(0, 2, 1), atol=1e-9)
    assert np.linalg.eigvalsh(bank.covariance).min() > -1e-9
    assert bank.weight.sum() == pytest.approx(1.0)
    assert bank.weight.min() > 0


def test_a_way_without_fixes_makes_place_and_heading_less_sure() -> None:
    bank = started(fix_of(0, 0), 0.0, 0.01)
    moved = bank
    for _ in range(100):
        moved = advanced(moved, np.array([1.0, 0.0]), 0.0, 0.1)
    assert moved.state[:2] == pytest.approx([100, 0])
    grown = np.diag(moved.state_covariance) - np.diag(bank.state_covariance)
    # 1 % of 100 m ahead; 1 degree and more to the side.
    assert 0.8 < math.sqrt(grown[0]) < 1.3
    assert math.sqrt(grown[1]) > 0.8
    assert math.sqrt(grown[YAW]) > math.radians(0.9)


def test_a_parked_car_loses_nothing_but_time() -> None:
    bank = started(fix_of(0, 0), 0.0, 0.01)
    later = advanced(bank, NOWHERE, 0.0, 60.0)
    assert later.state_covariance[:2, :2] == pytest.approx(bank.state_covariance[:2, :2])


def test_thousands_of_equal_fixes_of_a_parked_car_do_not_make_it_sure() -> None:
    bank = started(fix_of(0, 0), 0.0, 0.01)
    for _ in range(600):
        bank = after_fix(advanced(bank, NOWHERE, 0.0, 0.1), fix_of(0.0, 0.0))
    assert math.sqrt(bank.state_covariance[0, 0]) > 0.7


@pytest.mark.parametrize("kind", ["white", "slow"])
def test_the_bank_finds_out_what_a_receiver_is_like(kind: str) -> None:
    random = np.random.default_rng(5)
    bank, slow = started(fix_of(0, 0), 0.0, 0.01), random.normal(0, 1, 2)
    kept = math.exp(-0.1 / 100)
    for _ in range(900):
        slow = kept * slow + math.sqrt(1 - kept**2) * random.normal(0, 1, 2)
        error = random.normal(0, 1, 2) if kind == "white" else 0.995 * slow + random.normal(0, 0.1, 2)
        bank = after_fix(advanced(bank, NOWHERE, 0.0, 0.1), fix_of(*error))
    best = ERROR_MODELS[int(np.argmax(bank.weight))]
    assert (best.white > 0.85) if kind == "white" else (best.white == 0.1)


def test_another_place_keeps_what_is_known_of_heading_and_odometry() -> None:
    bank = pose_filter.with_scale(started(fix_of(0, 0), 0.7, 0.01), 0.02, 0.001)
    moved = pose_filter.moved_to(bank, fix_of(50, 0, 2.0))
    assert moved.state[:2] == pytest.approx([50, 0])
    assert moved.state[[YAW, SCALE]] == pytest.approx(bank.state[[YAW, SCALE]])
    assert moved.state_covariance[0, 0] == pytest.approx(4.0, rel=1e-4)


def with_late_fixes(
    delay_s: float, speeds_mps: list[float], turn_rad: float = 0.0, bias_m: tuple[float, float] = (0.0, 0.0)
) -> tuple[PlaneFilter, Vector]:
    """The bank after a second at each of these speeds, turning in each, with a biased receiver; and the true place."""
    place, yaw, bank = np.zeros(2), 0.0, None
    for speed in speeds_mps:
        for _ in range(10):
            velocity = speed * np.array([math.cos(yaw), math.sin(yaw)])
            fix = fix_of(*(place - delay_s * velocity + bias_m), speed_mps=speed)
            if bank is None:
                bank = started(fix, 0.0, 0.01)
            bank = after_fix(bank, fix)
            bank = advanced(bank, np.array([0.1 * speed, 0.0]), turn_rad / 10, 0.1)
            place, yaw = place + 0.1 * velocity, yaw + turn_rad / 10
    assert bank is not None
    return bank, place


def ahead_sd_m(bank: PlaneFilter) -> float:
    return math.sqrt(bank.state_covariance[0, 0])


@pytest.mark.parametrize("delay_s", [0.0, 0.1, 0.2])
def test_how_late_fixes_are_is_found_out_where_the_car_stops_and_goes(delay_s: float) -> None:
    bank, place = with_late_fixes(
        delay_s, [5.0, 10.0, 15.0, 10.0, 5.0, 0.0, 0.0, 5.0, 10.0, 15.0, 15.0], bias_m=(1, -1)
    )
    assert bank.state[DELAY] == pytest.approx(delay_s, abs=0.03)
    assert bank.state[:2] - place == pytest.approx([1, -1], abs=0.5)


def test_how_late_fixes_are_is_found_out_where_the_car_turns() -> None:
    bank, place = with_late_fixes(0.15, [8.0] * 24, turn_rad=math.pi / 12, bias_m=(1, -1))
    assert bank.state[DELAY] == pytest.approx(0.15, abs=0.03)
    assert bank.state[:2] - place == pytest.approx([1, -1], abs=0.5)


def test_at_one_speed_on_a_straight_road_nobody_knows_how_late_fixes_are_and_the_place_ahead_is_that_unsure() -> None:
    steady, _ = with_late_fixes(0.15, [20.0] * 10)
    assert math.sqrt(steady.state_covariance[DELAY, DELAY]) == pytest.approx(DELAY_SD_S, rel=0.1)
    assert 1.8 < ahead_sd_m(steady) < 2.6
    assert math.sqrt(steady.state_covariance[1, 1]) < 1.1


def test_a_delay_that_is_known_outlasts_a_jump_and_fades_over_days_not_minutes() -> None:
    bank, _ = with_late_fixes(0.15, [5.0, 15.0, 5.0, 0.0, 0.0, 15.0])
    for later in (pose_filter.moved_to(bank, fix_of(80, 0)), advanced(bank, NOWHERE, 0.0, 600.0)):
        assert later.state[DELAY] == pytest.approx(bank.state[DELAY], abs=0.01)
        assert later.state_covariance[DELAY, DELAY] < (0.5 * DELAY_SD_S) ** 2
    days_later = advanced(bank, NOWHERE, 0.0, 3e5)
    assert math.sqrt(days_later.state_covariance[DELAY, DELAY]) == pytest.approx(DELAY_SD_S, rel=0.01)


@pytest.mark.parametrize("counted", [0.97, 1.0, 1.02])
def test_wheels_that_count_wrong_are_found_out_by_the_receiver_s_speed(counted: float) -> None:
    """Twenty seconds with fixes, then a tunnel of 300 m: at 3 % it would cost 9 m."""
    state = PoseFilter()
    for number in range(400):
        stamp_s, x_m = NOON_S + number / 10, 1.5 * number
        position, altitude_m = ORIGIN.geodetic(np.array([x_m, 0.0, 0.0]))
        fix = GnssFix(position, altitude_m, None, 1.0, 2.0, course_rad=math.pi / 2, speed_mps=15.0)
        odom = planar(counted * x_m, 0.0, 0.0)
        state, found = update(
            state, LidarFrame(stamp_s, NO_POINTS, odom_from_vehicle=odom, gnss=fix if number < 200 else None)
        )
    assert found.pose is not None, found.reason
    assert ORIGIN.enu(found.pose.position, found.pose.altitude_m)[0] == pytest.approx(598.5, abs=1.5)


def test_no_scale_is_read_from_a_slow_car_or_a_receiver_that_says_no_speed() -> None:
    position, altitude_m = ORIGIN.geodetic(np.zeros(3))
    fix = GnssFix(position, altitude_m, None, 1.0, 2.0, speed_mps=10.0)
    history, slow = OdometryHistory(), OdometryHistory()
    for number in range(10):
        history = history.with_pose(number / 10, planar(float(number), 0, 0.0))
        slow = slow.with_pose(number / 10, planar(0.1 * number, 0, 0.0))
    measured = measured_scale(fix, history.poses[-1], history, 1.0)
    assert measured is not None
    assert measured.scale == pytest.approx(0.0)
    assert measured_scale(replace(fix, speed_mps=None), history.poses[-1], history, 1.0) is None
    assert measured_scale(replace(fix, speed_mps=math.nan), history.poses[-1], history, 1.0) is None
    assert measured_scale(fix, slow.poses[-1], slow, 1.0) is None
