"""Odometry where the source brings none: wheels, or the sweeps."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kiss_icp.kiss_icp import KissICP

from contract.geometry import LatLon
from tests.unit.vehicle_client.making import NOON_S, planar
from vehicle_client.frames import Matrix, apply, inverse, rigid, yaw_of
from vehicle_client.positioning.odometry import COASTS_S, DeadReckoning, Given, ScanMatching, Wheels, tracker_for
from vehicle_client.positioning.odometry_history import ODOMETRY_GAP_S
from vehicle_client.sensing.calibration import curvature_of
from vehicle_client.sensing.deskew import Twist, deskew
from vehicle_client.sources.frame import GnssFix, LidarFrame, Motion

NO_POINTS = np.empty((0, 3), dtype=np.float32)
MAST = rigid(np.eye(3), np.array([0.8, 0.0, 1.7]))


def frame(seconds: float, *motions: Motion, points: np.ndarray = NO_POINTS) -> LidarFrame:
    return LidarFrame(NOON_S + seconds, points, motions=motions)


def motion(seconds: float, speed: float | None = 10.0, rate: float | None = 0.0) -> Motion:
    return Motion(NOON_S + seconds, speed, rate)


@settings(max_examples=50, deadline=None)
@given(st.floats(0.5, 30), st.floats(-0.8, 0.8), st.floats(0.5, 10))
def test_constant_speed_and_rate_lead_along_an_arc(speed: float, rate: float, seconds: float) -> None:
    said = [motion(k / 20, speed, rate) for k in range(int(seconds * 20) + 1)]
    end_s = NOON_S + seconds
    place = DeadReckoning(NOON_S).after(said, end_s).odom_from_vehicle()
    assert place is not None
    turn = rate * seconds
    ahead = speed * seconds * np.sinc(turn / math.pi)
    half = speed * seconds * turn / 2 * np.sinc(turn / (2 * math.pi)) ** 2
    assert place[:2, 3] == pytest.approx([ahead, half], abs=1e-5 * (1 + speed * seconds))
    assert math.remainder(yaw_of(place) - turn, 2 * math.pi) == pytest.approx(0, abs=1e-6)


def test_wheels_follow_the_steering_where_no_rate_is_said() -> None:
    wheels, steering = Wheels(2.7), 0.05
    for k in range(101):
        shown = LidarFrame(NOON_S + k / 10, NO_POINTS, steering_rad=steering, speed_mps=5.0)
        place = wheels.odom_from_vehicle(shown)
    assert place is not None
    expected = 5.0 * 10 * curvature_of(steering, 2.7)
    assert math.remainder(yaw_of(place) - expected, 2 * math.pi) == pytest.approx(0, abs=0.01)


def test_a_parked_car_is_not_turned_by_its_gyro() -> None:
    parked = DeadReckoning(NOON_S).after([motion(k / 10, 0.0, 0.02) for k in range(600)], NOON_S + 60)
    assert parked.yaw_rad == 0.0


def test_when_the_wheels_fall_silent_there_is_soon_no_odometry_and_then_again() -> None:
    wheels = Wheels(2.7)
    assert wheels.odom_from_vehicle(frame(0.0, motion(0.0))) is not None
    assert wheels.odom_from_vehicle(frame(COASTS_S - 0.1)) is not None
    assert wheels.odom_from_vehicle(frame(COASTS_S + 0.1)) is None
    assert wheels.odom_from_vehicle(frame(1.0, motion(1.0))) is not None


@pytest.mark.parametrize(
    "bad", [motion(0.05, math.nan), motion(0.05, 5.0, math.inf), Motion(math.nan, 5.0), motion(0, None)]
)
def test_a_motion_that_is_not_finite_or_says_no_speed_is_left_out(bad: Motion) -> None:
    wheels = Wheels(2.7)
    wheels.odom_from_vehicle(frame(0.0, motion(0.0)))
    place = wheels.odom_from_vehicle(frame(0.1, bad))
    assert place is not None
    assert place[:2, 3] == pytest.approx([1.0, 0.0], abs=1e-6)


def test_motions_that_come_late_and_a_clock_set_back_move_no_car_backwards() -> None:
    car = DeadReckoning(NOON_S).after([motion(0.0), motion(0.2), motion(0.1)], NOON_S + 0.3)
    assert car.x_m == pytest.approx(3.0)
    after = car.after([motion(-99.9)], NOON_S - 99.8)
    assert after.x_m == pytest.approx(4.0)


def test_a_clock_that_is_set_an_hour_ahead_does_not_drive_the_car_for_an_hour() -> None:
    car = DeadReckoning(NOON_S).after([motion(0.0)], NOON_S + 3600)
    assert car.x_m < 20


def test_the_best_that_a_drive_brings_is_taken() -> None:
    assert isinstance(tracker_for(LidarFrame(0.0, NO_POINTS, odom_from_vehicle=np.eye(4)), MAST, 2.7), Given)
    assert isinstance(tracker_for(frame(0.0, motion(0.0)), MAST, 2.7), Wheels)
    assert isinstance(tracker_for(LidarFrame(0.0, NO_POINTS), MAST, 2.7), ScanMatching)


def yard(seed: int = 1) -> np.ndarray:
    """Walls, posts and a floor around a car, in `odom`."""
    random = np.random.default_rng(seed)
    floor = np.column_stack([random.uniform(-25, 45, 12_000), random.uniform(-15, 15, 12_000), np.zeros(12_000)])
    walls = [
        np.column_stack([random.uniform(-25, 45, 5_000), np.full(5_000, y), random.uniform(0, 4, 5_000)])
        for y in (-12.0, 11.0)
    ]
    posts = [
        np.column_stack([np.full(150, x), np.full(150, y) + random.uniform(-0.1, 0.1, 150), random.uniform(0, 3, 150)])
        for x, y in random.uniform([-20, -10], [40, 10], (40, 2))
    ]
    return np.vstack([floor, *walls, *posts])


@pytest.mark.parametrize("rolling", [False, True])
def test_sweeps_tell_the_motion_of_the_car_that_carries_the_sensor(rolling: bool) -> None:
    """Ten sweeps at 8 m/s in a curve; a rolling sensor's points come from a tenth of a second.

    The motion before the first sweep is unknown, so that the first two stay bent: the way from then on is looked at.
    """
    matcher, things = ScanMatching(MAST), yard()
    twist = Twist(np.array([8.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.2]))
    odom_from_vehicle: Matrix = np.eye(4)
    early: Matrix = np.eye(4)
    for k in range(10):
        in_vehicle = apply(inverse(odom_from_vehicle), things).astype(np.float32)
        times = np.random.default_rng(k).uniform(-0.1, 0, len(things)).astype(np.float32) if rolling else None
        if times is not None:
            # What was seen earlier by a car farther back: the motion undone, to first order in the turn of 0.02 rad.
            in_vehicle = 2 * in_vehicle - deskew(in_vehicle, times, twist)
        points = apply(inverse(MAST), in_vehicle).astype(np.float32)
        found = matcher.odom_from_vehicle(LidarFrame(NOON_S + k / 10, points, point_time_s=times))
        assert found is not None
        early = found if k == 3 else early
        odom_from_vehicle = odom_from_vehicle @ twist.now_from_then(0.1)
    moved, expected = inverse(early) @ found, twist.now_from_then(0.6)
    assert moved[:2, 3] == pytest.approx(expected[:2, 3], abs=0.15)
    assert yaw_of(moved) == pytest.approx(yaw_of(expected), abs=0.01)


@pytest.mark.parametrize("source", ["receiver", "car"])
@pytest.mark.parametrize("speed_mps", [25.0, 40.0])
def test_a_drive_that_begins_fast_is_followed_from_its_second_sweep_if_the_speed_is_known(
    speed_mps: float, source: str
) -> None:
    """Without it KISS-ICP takes the car for standing."""
    matcher, things = ScanMatching(MAST), yard()
    for k in range(4):
        points = apply(inverse(MAST), apply(planar(-speed_mps * 0.1 * k, 0, 0.0), things)).astype(np.float32)
        # Receivers err by a tenth of a metre a second, wheels by a hundredth of the speed.
        said = LidarFrame(NOON_S + k / 10, points, speed_mps=0.99 * speed_mps if source == "car" else None)
        if source == "receiver":
            fix = GnssFix(
                LatLon(latitude_deg=48.0, longitude_deg=11.0), 500.0, None, 1.0, 2.0, speed_mps=speed_mps + 0.1
            )
            said = replace(said, gnss=fix)
        found = matcher.odom_from_vehicle(said)
        assert found is not None
        assert found[:2, 3] == pytest.approx([speed_mps * 0.1 * k, 0.0], abs=0.05)


@pytest.mark.parametrize("speed_mps", [math.nan, math.inf, -3.0, 4.0])
def test_a_speed_that_makes_no_sense_or_may_be_backwards_says_nothing_of_the_first_motion(speed_mps: float) -> None:
    matcher, things = ScanMatching(MAST), yard()
    for k in range(3):
        points = apply(inverse(MAST), apply(planar(0.3 * k, 0, 0.0), things)).astype(np.float32)
        found = matcher.odom_from_vehicle(LidarFrame(NOON_S + k / 10, points, speed_mps=speed_mps))
    assert found is not None
    assert found[0, 3] == pytest.approx(-0.6, abs=0.05)


def test_a_sweep_without_points_has_no_odometry_and_spoils_none_after_it() -> None:
    matcher, things = ScanMatching(np.eye(4)), yard()
    for k in range(3):
        in_car = apply(planar(-0.5 * k, 0, 0.0), things).astype(np.float32)
        found = matcher.odom_from_vehicle(LidarFrame(NOON_S + k / 10, in_car))
        assert matcher.odom_from_vehicle(LidarFrame(NOON_S + k / 10 + 0.05, NO_POINTS)) is None
        nan = np.full((500, 3), np.nan, dtype=np.float32)
        assert matcher.odom_from_vehicle(LidarFrame(NOON_S + k / 10 + 0.06, nan)) is None
    assert found is not None
    assert found[0, 3] == pytest.approx(1.0, abs=0.1)


def driven(matcher: ScanMatching, indices: Iterable[int], speed_mps: float) -> list[Matrix | None]:
    """Poses along a straight drive, ten sweeps a second, of which those with these numbers came."""
    things, found = yard(), []
    for index in indices:
        in_car = apply(planar(-speed_mps * index / 10, 0, 0.0), things).astype(np.float32)
        found.append(matcher.odom_from_vehicle(LidarFrame(NOON_S + index / 10, in_car)))
    return found


def test_where_sweeps_were_left_out_the_car_is_expected_farther_on() -> None:
    """Six sweeps at 8 m/s, 0.8 m apart, then each fourth: 3.2 m."""
    found = driven(ScanMatching(np.eye(4)), [*range(6), 9, 13, 17], 8.0)
    places = [pose[0, 3] for pose in found if pose is not None]
    assert np.diff(places[5:]) == pytest.approx([3.2, 3.2, 3.2], abs=0.15)


@pytest.mark.parametrize("left_out", [5, 12])
def test_after_sweeps_that_were_left_out_the_car_is_expected_no_farther_than_it_drives(left_out: int) -> None:
    """Half a second and more is too long to unbend a sweep by, and not for what the next sweep is to be laid on."""
    after = 6 + left_out
    found = driven(ScanMatching(np.eye(4)), [*range(6), *range(after, after + 4)], 8.0)
    places = [pose[0, 3] for pose in found if pose is not None]
    assert np.diff(places[5:]) == pytest.approx([0.8 * (left_out + 1), 0.8, 0.8, 0.8], abs=0.15)


def test_after_a_gap_in_time_odometry_begins_anew() -> None:
    found = driven(ScanMatching(np.eye(4)), [0, 1, 2, 30, 31, 32], 5.0)
    assert found[3] == pytest.approx(np.eye(4), abs=1e-6)
    assert found[5] is not None
    assert found[5][0, 3] == pytest.approx(1.0, abs=0.1)


def test_a_match_that_is_no_number_is_silence_and_then_a_beginning(monkeypatch: pytest.MonkeyPatch) -> None:
    class Torn(KissICP):
        def register_frame(self, frame: np.ndarray, timestamps: np.ndarray) -> None:
            super().register_frame(frame, timestamps)
            if np.linalg.norm(self.last_pose[:3, 3]) > 0.9:
                self.last_pose = np.full((4, 4), np.nan)

    monkeypatch.setattr("kiss_icp.kiss_icp.KissICP", Torn)
    found = driven(ScanMatching(np.eye(4)), range(20), 5.0)
    silent = [index for index, pose in enumerate(found) if pose is None]
    assert silent == list(range(2, 3 + int(10 * ODOMETRY_GAP_S)))
    assert found[18] == pytest.approx(np.eye(4), abs=1e-6)
