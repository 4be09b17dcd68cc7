from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.geometry import LatLon
from vehicle_client.frames import GeoOrigin, rigid, rotation_about_z, yaw_of
from vehicle_client.sources.assembling import MOST_FIXES, MOST_MOTIONS, Assembler, pose_at
from vehicle_client.sources.complaints import Complaints
from vehicle_client.sources.frame import GnssFix, LidarFrame, Motion, SourceError
from vehicle_client.sources.mounting import Lever
from vehicle_client.sources.readings import GroundVelocity, Heading, Odometry, Picture, Reading, Steering
from vehicle_client.sources.stamps import AGREEING, MOST_GAP_S, StampGate

START_S = 1_780_000_000.0
PLACE = LatLon(latitude_deg=38.2466, longitude_deg=21.7346)


def sweep(after_s: float) -> LidarFrame:
    return LidarFrame(START_S + after_s, np.ones((4, 3), np.float32))


def fix(after_s: float) -> GnssFix:
    return GnssFix(PLACE, 20.0, None, 1.0, 2.0, stamp_s=START_S + after_s)


def picture(after_s: float, grey: int) -> Picture:
    return Picture(START_S + after_s, lambda: np.full((2, 2, 3), grey, np.uint8))


def assembled(*readings: object, lever: Lever | None = None) -> list[LidarFrame]:
    return list(Assembler(Complaints(), lever or Lever()).frames(readings))


def test_a_frame_brings_what_came_since_the_sweep_before_and_no_older_thing_twice() -> None:
    first, second = assembled(fix(0), picture(0, 1), picture(0.05, 2), sweep(0.1), sweep(0.2))
    assert (int(first.image[0, 0, 0]), first.image_stamp_s) == (2, START_S + 0.05)
    assert first.gnss.stamp_s == START_S
    assert (second.image, second.image_stamp_s, second.gnss) == (None, None, None)


def test_a_picture_that_nobody_looks_at_is_not_decoded() -> None:
    def fail() -> np.ndarray:
        raise AssertionError

    (frame,) = assembled(Picture(START_S, fail), picture(0.01, 3), sweep(0.1))
    assert int(frame.image[0, 0, 0]) == 3


def test_a_picture_that_is_not_whole_costs_no_sweep() -> None:
    def fail() -> np.ndarray:
        raise SourceError("cut")

    complaints = Complaints()
    (frame,) = Assembler(complaints).frames([Picture(START_S, fail), sweep(0.1)])
    assert (frame.image, frame.image_stamp_s, complaints.count) == (None, None, 1)


def test_motions_come_in_the_order_of_time_and_do_not_pile_up() -> None:
    moving = [Motion(START_S + after, 1.0, 0.0) for after in (0.03, 0.01, 0.02)]
    (frame,) = assembled(*moving, sweep(0.1))
    assert [m.stamp_s - START_S for m in frame.motions] == pytest.approx([0.01, 0.02, 0.03], abs=1e-6)
    (frame,) = assembled(*(Motion(START_S + i / 1000, 1.0) for i in range(3 * MOST_MOTIONS)), sweep(10))
    assert len(frame.motions) == MOST_MOTIONS


def test_heading_and_course_join_the_fix_of_their_time_alone() -> None:
    near = assembled(Heading(START_S, 1.0), GroundVelocity(START_S, 2.0, 8.0), fix(0.1), sweep(0.2))[0].gnss
    assert (near.heading_rad, near.course_rad, near.speed_mps) == (1.0, 2.0, 8.0)
    late = assembled(Heading(START_S, 1.0), GroundVelocity(START_S, 2.0, 8.0), fix(0.5), sweep(0.6))[0].gnss
    assert (late.heading_rad, late.course_rad, late.speed_mps) == (None, None, None)


def test_the_fix_is_moved_by_the_antennas_place_as_the_car_points() -> None:
    lever = Lever(np.array([-0.5, 0.4, 1.5]), imu_yaw_rad=math.pi / 2)
    # The unit looks to the car's left, which is north: the car points east.
    moved = assembled(Heading(START_S, 0.0), fix(0.1), sweep(0.2), lever=lever)[0].gnss
    assert moved.heading_rad == pytest.approx(math.pi / 2)
    assert GeoOrigin(PLACE, 20.0).enu(moved.position, moved.altitude_m) == pytest.approx([0.5, -0.4, -1.5], abs=1e-6)
    assert moved.antenna_m == (0.0, 0.0, 0.0)
    (unknown,) = assembled(fix(0.1), sweep(0.2), lever=lever)
    assert (unknown.gnss.position.latitude_deg, unknown.gnss.altitude_m) == pytest.approx((38.2466, 18.5), abs=1e-9)
    assert unknown.gnss.antenna_m == (-0.5, 0.4, 0.0)
    (unsaid,) = assembled(fix(0.1), sweep(0.2))
    assert unsaid.gnss.antenna_m is None


def test_a_receiver_faster_than_the_sweeps_loses_no_fix_and_each_has_the_course_of_its_time() -> None:
    readings: list[Reading] = []
    for tenth in range(8):
        readings += [fix(tenth / 10), GroundVelocity(START_S + tenth / 10, 0.1 * tenth, 8.0)]
        readings += [sweep(0.35), sweep(0.38)] if tenth == 3 else []
    first, nothing, last = assembled(*readings, sweep(0.75))
    for frame, tenths in ((first, range(4)), (last, range(4, 8))):
        assert [f.stamp_s for f in frame.fixes] == pytest.approx([START_S + t / 10 for t in tenths])
        assert [f.course_rad for f in frame.fixes] == pytest.approx([0.1 * t for t in tenths])
    assert nothing.fixes == ()


def test_fixes_of_a_drive_without_sweeps_do_not_pile_up() -> None:
    (frame,) = assembled(*(fix(n / 10) for n in range(500)), sweep(50.0))
    assert len(frame.fixes) == MOST_FIXES + 1
    assert frame.fixes[-1].stamp_s == pytest.approx(START_S + 49.9)


def test_speed_is_the_odometrys_else_the_wheels_else_the_receivers_if_it_is_fresh() -> None:
    pose, wheels = Odometry(START_S, np.eye(4), 1.0), Motion(START_S, 2.0)
    over_ground = GroundVelocity(START_S, 0.0, 3.0)
    assert assembled(over_ground, wheels, pose, sweep(0.1))[0].speed_mps == 1.0
    assert assembled(over_ground, wheels, sweep(0.1))[0].speed_mps == 2.0
    assert assembled(over_ground, sweep(0.1))[0].speed_mps == 3.0
    assert assembled(over_ground, sweep(5.0))[0].speed_mps is None


def test_steering_stays_until_it_is_said_anew() -> None:
    frames = assembled(Steering(START_S, 0.1), sweep(0.1), sweep(0.2), Steering(START_S, -0.1), sweep(0.3))
    assert [f.steering_rad for f in frames] == [0.1, 0.1, -0.1]


@given(st.floats(-0.2, 0.2), st.floats(-3, 3), st.floats(0.005, 0.1))
def test_a_pose_between_or_after_others_lies_on_their_motion(after_s: float, rate: float, period_s: float) -> None:
    """A car at 10 m/s that turns about its own z."""
    poses = []
    for index in range(60):
        time_s = index * period_s
        pose = rigid(rotation_about_z(rate * time_s), np.array([10 * time_s, 2.0, 0.0]))
        poses.append(Odometry(START_S + time_s, pose))
    last_s = 59 * period_s
    found = pose_at(poses, START_S + last_s + after_s)
    assert found[:3, 3] == pytest.approx([10 * (last_s + after_s), 2.0, 0.0], abs=1e-4)
    assert math.remainder(yaw_of(found) - rate * (last_s + after_s), 2 * math.pi) == pytest.approx(0, abs=1e-4)


@pytest.mark.parametrize("period_s", [0.005, 0.02, 0.1])
def test_noise_of_poses_is_hardly_larger_where_they_are_carried_on(period_s: float) -> None:
    rng = np.random.default_rng(4)
    errors = []
    for _ in range(200):
        noisy = [
            Odometry(START_S + i * period_s, rigid(np.eye(3), np.array([rng.normal(0, 0.001), 0.0, 0.0])))
            for i in range(30)
        ]
        errors.append(pose_at(noisy, noisy[-1].stamp_s + 0.1)[0, 3])
    assert np.std(errors) < 0.005


def test_a_pose_that_is_too_old_is_none() -> None:
    assert assembled(Odometry(START_S, np.eye(4)), sweep(1.0))[0].odom_from_vehicle is None


def test_odometry_said_twice_or_set_back_begins_again() -> None:
    poses = [Odometry(START_S + t, rigid(np.eye(3), np.array([x, 0.0, 0.0]))) for t, x in ((0, 0), (0.1, 1), (0.1, 5))]
    assert assembled(*poses, sweep(0.15))[0].odom_from_vehicle[0, 3] == 5


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), max_size=30))
def test_stamps_that_pass_always_rise(stamps: list[float]) -> None:
    gate = StampGate()
    passed = [stamp for stamp in stamps if gate.refusal(stamp) is None]
    assert all(np.diff(passed) > 0)
    assert all(0 <= stamp < 5e9 for stamp in passed)


@given(st.lists(st.floats(0.001, MOST_GAP_S), min_size=1, max_size=30), st.integers(0, 29), st.floats(70, 1e8))
def test_one_leap_forward_hides_no_other_sweep(steps: list[float], at: int, leap_s: float) -> None:
    gate = StampGate()
    stamps = list(START_S + np.cumsum(steps))
    leaping = [*stamps[: at + 1], stamps[min(at, len(stamps) - 1)] + leap_s, *stamps[at + 1 :]]
    passed = [stamp for stamp in leaping if gate.refusal(stamp) is None]
    assert passed == stamps


def test_a_clock_that_was_set_forward_is_believed_after_some_sweeps() -> None:
    gate = StampGate()
    assert gate.refusal(12.0) is None
    refused = [gate.refusal(START_S + 0.1 * i) is not None for i in range(5)]
    assert refused == [True] * (AGREEING - 1) + [False] * (6 - AGREEING)
