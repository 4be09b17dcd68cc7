"""The car's pose: fixes and odometry joined; silence rather than a guess."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contract.geometry import LatLon
from tests.unit.vehicle_client.making import NOON_S, ORIGIN, planar, pose_at
from vehicle_client.frames import GeoOrigin, Matrix, apply, inverse, yaw_from_heading
from vehicle_client.pose import STALE_AFTER_S, Pose, PoseFilter, update
from vehicle_client.sources.frame import GnssFix, LidarFrame

RATE_HZ = 10
NO_POINTS = np.empty((0, 3), dtype=np.float32)


def fix_at(east_m: float, north_m: float, heading_rad: float, sd_m: float = 1.0) -> GnssFix:
    position, altitude_m = ORIGIN.geodetic(np.array([east_m, north_m, 0.0]))
    return GnssFix(position, altitude_m, heading_rad % (2 * math.pi), sd_m, 2.0)


def frame_at(stamp_s: float, odom_from_vehicle: Matrix | None, fix: GnssFix | None) -> LidarFrame:
    return LidarFrame(stamp_s, NO_POINTS, odom_from_vehicle=odom_from_vehicle, gnss=fix, speed_mps=10.0)


def driven(
    heading_rad: float = 0.0,
    *,
    frames: int = 150,
    noise_m: float = 0.0,
    bias_m: tuple[float, float] = (0.0, 0.0),
    heading_noise_rad: float = 0.0,
    odom_yaw_rad: float = 0.4,
) -> Pose:
    """The last pose of a straight drive at 10 m/s from the origin; odometry has axes of its own."""
    random = np.random.default_rng(7)
    ahead = np.array([math.sin(heading_rad), math.cos(heading_rad)])
    enu_from_odom = planar(50.0, -20.0, odom_yaw_rad)
    state, pose = PoseFilter(), None
    for number in range(frames):
        east, north = ahead * number
        truth = planar(east, north, yaw_from_heading(heading_rad))
        noisy = np.array([east, north]) + random.normal(0, noise_m, 2) + bias_m
        fix = fix_at(noisy[0], noisy[1], heading_rad + random.normal(0, heading_noise_rad))
        state, pose = update(state, frame_at(NOON_S + number / RATE_HZ, inverse(enu_from_odom) @ truth, fix))
    assert pose is not None
    return pose


def error_m(pose: Pose, heading_rad: float, frames: int = 150) -> Matrix:
    """East and north error at the end of `driven`, on the ellipsoid."""
    east, north = (frames - 1) * math.sin(heading_rad), (frames - 1) * math.cos(heading_rad)
    return ORIGIN.enu(pose.position, pose.altitude_m)[:2] - [east, north]


def test_without_odometry_there_is_no_pose() -> None:
    state, pose = update(PoseFilter(), frame_at(NOON_S, None, fix_at(0, 0, 0)))
    assert pose is None
    assert state.fixes == 0


def test_without_any_fix_there_is_no_pose() -> None:
    assert update(PoseFilter(), frame_at(NOON_S, np.eye(4), None))[1] is None


def test_a_stale_fix_gives_no_pose_and_a_new_one_does_again() -> None:
    state, pose = update(PoseFilter(), frame_at(NOON_S, np.eye(4), fix_at(0, 0, 0)))
    assert pose is not None
    state, late = update(state, frame_at(NOON_S + STALE_AFTER_S, np.eye(4), None))
    assert late is not None
    state, stale = update(state, frame_at(NOON_S + STALE_AFTER_S + 0.1, np.eye(4), None))
    assert stale is None
    _, again = update(state, frame_at(NOON_S + STALE_AFTER_S + 0.2, np.eye(4), fix_at(0, 0, 0)))
    assert again is not None


@pytest.mark.parametrize("bad", ["altitude_m", "heading_rad", "sd_m", "altitude_sd_m"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_fix_that_is_not_finite_counts_as_none(bad: str, value: float) -> None:
    broken = replace(fix_at(0, 0, 0), **{bad: value})
    state, _ = update(PoseFilter(), frame_at(NOON_S, np.eye(4), fix_at(0, 0, 0)))
    state, pose = update(state, frame_at(NOON_S + 0.1, np.eye(4), broken))
    assert state.fixes == 1
    assert pose is not None
    assert np.isfinite(pose.enu_from_vehicle).all()


def test_odometry_that_is_not_finite_gives_no_pose_and_leaves_the_state() -> None:
    state, _ = update(PoseFilter(), frame_at(NOON_S, np.eye(4), fix_at(0, 0, 0)))
    after, pose = update(state, frame_at(NOON_S + 0.1, np.full((4, 4), np.nan), fix_at(0, 0, 0)))
    assert pose is None
    assert after is state


@pytest.mark.parametrize("heading_deg", range(0, 360, 45))
def test_perfect_fixes_give_the_perfect_pose(heading_deg: int) -> None:
    heading = math.radians(heading_deg)
    pose = driven(heading)
    assert error_m(pose, heading) == pytest.approx([0, 0], abs=0.01)
    assert math.remainder(pose.heading_rad - heading, 2 * math.pi) == pytest.approx(0, abs=1e-6)
    assert pose.altitude_m == pytest.approx(20.0, abs=0.01)


def test_the_noise_of_single_fixes_is_averaged_away() -> None:
    # 100 fixes of 1 m leave 0.1 m per axis; the heading's 0.02 rad leave 0.002 rad over a lever of some 70 m.
    pose = driven(0.7, noise_m=1.0, heading_noise_rad=0.02)
    assert np.linalg.norm(error_m(pose, 0.7)) < 0.5


def test_a_bias_that_all_fixes_share_stays_and_the_pose_says_how_unsure_it_is() -> None:
    pose = driven(0.7, bias_m=(1.5, -0.8))
    assert error_m(pose, 0.7) == pytest.approx([1.5, -0.8], abs=0.02)
    assert pose.sd_m == 1.0


@settings(max_examples=25, deadline=None)
@given(st.floats(-0.05, 0.05), st.floats(-4, 4))
def test_headings_around_north_have_no_seam(heading_rad: float, odom_yaw_rad: float) -> None:
    pose = driven(heading_rad, frames=40, heading_noise_rad=0.02, odom_yaw_rad=odom_yaw_rad)
    assert abs(math.remainder(pose.heading_rad - heading_rad, 2 * math.pi)) < 0.015
    assert 0 <= pose.heading_rad < 2 * math.pi


def test_between_fixes_odometry_carries_the_pose() -> None:
    state, _ = update(PoseFilter(), frame_at(NOON_S, planar(5, 5, 0.0), fix_at(0, 0, math.pi / 2)))
    _, pose = update(state, frame_at(NOON_S + 1, planar(15, 5, 0.0), None))
    assert pose is not None
    assert ORIGIN.enu(pose.position, pose.altitude_m)[:2] == pytest.approx([10, 0], abs=1e-3)
    assert pose.odom_from_vehicle == pytest.approx(planar(15, 5, 0.0), abs=1e-9)


@pytest.mark.parametrize("latitude_deg", [38.2, -60.0])
def test_a_long_drive_costs_no_accuracy(latitude_deg: float) -> None:
    """Tens of kilometres east along a parallel, where north is no longer that of the start."""
    start = LatLon(latitude_deg=latitude_deg, longitude_deg=20.0)
    level = np.eye(4)
    state, _ = update(PoseFilter(), frame_at(NOON_S, level, GnssFix(start, 0.0, math.pi / 2, 1.0, 2.0)))
    far = GeoOrigin(LatLon(latitude_deg=latitude_deg, longitude_deg=20.5), 0.0)
    for number in range(900):
        x_m = 1.5 * number - 1_350
        position, altitude_m = far.geodetic(np.array([x_m, 0.0, 0.0]))
        fix = GnssFix(position, altitude_m, math.pi / 2, 1.0, 2.0)
        state, pose = update(state, frame_at(NOON_S + 1 + number / 10, planar(30_000 + x_m, 0.0, 0.0), fix))
    assert pose is not None
    assert far.enu(pose.position, pose.altitude_m) == pytest.approx([x_m, 0.0, 0.0], abs=0.1)


def test_no_pose_jumps_where_the_origin_follows_the_car() -> None:
    state, before = PoseFilter(), None
    for number in range(800):
        x_m = 1.5 * number
        state, pose = update(state, frame_at(NOON_S + number / 10, planar(x_m, 0, 0.0), fix_at(x_m, 0, math.pi / 2)))
        assert pose is not None
        if before is not None:
            moved_m = before.in_vehicle(pose.position, pose.altitude_m)
            assert moved_m == pytest.approx([1.5, 0, 0], abs=0.03)
        before = pose


def test_a_place_ahead_lies_on_the_car_s_x_axis_and_one_to_the_left_on_y() -> None:
    pose = pose_at(100.0, 50.0, heading_rad=math.pi)
    ahead, left = (ORIGIN.geodetic(np.array(enu)) for enu in ([100.0, 30.0, 0.0], [103.0, 50.0, 0.0]))
    assert pose.in_vehicle(*ahead) == pytest.approx([20, 0, 0], abs=1e-3)
    assert pose.in_vehicle(*left) == pytest.approx([0, 3, 0], abs=1e-3)
    assert apply(inverse(pose.enu_from_vehicle), np.array([100.0, 50.0, 0.0])) == pytest.approx(np.zeros(3))
