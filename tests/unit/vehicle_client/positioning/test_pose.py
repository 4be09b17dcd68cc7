"""The car's pose: fixes and odometry joined; silence with a reason rather than a guess."""

from __future__ import annotations

import math
from dataclasses import replace
from uuid import UUID

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contract.geometry import LatLon
from tests.unit.vehicle_client.making import NOON_S, ORIGIN, planar, pose_at
from tests.unit.vehicle_client.positioning.pose_drives import (
    EAST,
    RATE_HZ,
    SPEED_MPS,
    along_x,
    driven,
    east_north_m,
    error_m,
    fix_at,
    frame_at,
    without_fixes,
)
from vehicle_client.frames import GeoOrigin, apply, inverse, yaw_of
from vehicle_client.positioning.pose import (
    LARGEST_SD_M,
    ODOMETRY_ALONE,
    STALE_AFTER_S,
    PoseFilter,
    PoseUpdate,
    StatedPlace,
    update,
)
from vehicle_client.reporting import compose_report
from vehicle_client.sources.frame import OF_VEHICLE, GnssFix


def test_without_odometry_there_is_no_pose() -> None:
    _, found = update(PoseFilter(), frame_at(NOON_S, None, fix_at(0, 0, 0)))
    assert found == PoseUpdate(None, "no odometry")


def test_without_any_fix_there_is_no_pose() -> None:
    assert update(PoseFilter(), frame_at(NOON_S, np.eye(4), None))[1] == PoseUpdate(None, "no satellite fix yet")


def test_an_outage_is_bridged_with_growing_doubt_and_a_reason_at_its_end() -> None:
    state, found = along_x(100)
    assert found.pose is not None
    sds = [found.pose.sd_m]
    number = 100
    while found.pose is not None and number < 2_000:
        state, found = update(state, frame_at(NOON_S + number / RATE_HZ, planar(number, 0, 0.0), None))
        sds.extend([found.pose.sd_m] if found.pose else [])
        number += 1
    assert sds == sorted(sds)
    assert 20 * RATE_HZ < number < STALE_AFTER_S * RATE_HZ + 102
    assert sds[-1] < LARGEST_SD_M
    assert found.reason is not None
    assert "unsure" in found.reason or "old" in found.reason
    _, again = along_x(1, first=number, state=state)
    assert east_north_m(again) == pytest.approx([number, 0], abs=1.0)


def test_a_parked_car_has_no_pose_when_its_last_fix_is_old() -> None:
    state, _ = update(PoseFilter(), frame_at(NOON_S, np.eye(4), fix_at(0, 0, EAST)))
    for second in range(1, int(STALE_AFTER_S) + 1):
        state, just = update(state, frame_at(NOON_S + second, np.eye(4), None))
    assert just.pose is not None
    _, late = update(state, frame_at(NOON_S + STALE_AFTER_S + 1, np.eye(4), None))
    assert late == PoseUpdate(None, "the last satellite fix is 61 s old")


@pytest.mark.parametrize("bad", ["altitude_m", "sd_m", "altitude_sd_m", "stamp_s"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_fix_that_is_not_finite_counts_as_none(bad: str, value: float) -> None:
    state, _ = update(PoseFilter(), frame_at(NOON_S, np.eye(4), fix_at(0, 0, 0)))
    broken = replace(fix_at(30, 0, 0), **{bad: value})
    _, with_broken = update(state, frame_at(NOON_S + 0.1, np.eye(4), broken))
    _, without = update(state, frame_at(NOON_S + 0.1, np.eye(4), None))
    assert with_broken.pose is not None and without.pose is not None  # noqa: PT018
    assert with_broken.pose.enu_from_vehicle == pytest.approx(without.pose.enu_from_vehicle)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_heading_that_is_not_finite_leaves_the_place_of_its_fix(value: float) -> None:
    state, _ = update(PoseFilter(), frame_at(NOON_S, np.eye(4), fix_at(0, 0, EAST)))
    broken = replace(fix_at(2, 0, 0), heading_rad=value)
    _, found = update(state, frame_at(NOON_S + 0.1, np.eye(4), broken))
    assert east_north_m(found)[0] > 0
    assert found.pose is not None
    assert found.pose.heading_rad == pytest.approx(EAST)


def test_odometry_that_is_not_finite_gives_no_pose_and_leaves_the_state() -> None:
    state, _ = update(PoseFilter(), frame_at(NOON_S, np.eye(4), fix_at(0, 0, 0)))
    after, found = update(state, frame_at(NOON_S + 0.1, np.full((4, 4), np.nan), fix_at(0, 0, 0)))
    assert found == PoseUpdate(None, "no odometry")
    assert after is state


@pytest.mark.parametrize("heading_deg", range(0, 360, 45))
def test_perfect_fixes_give_the_perfect_pose(heading_deg: int) -> None:
    heading = math.radians(heading_deg)
    pose = driven(heading)
    assert error_m(pose, heading) == pytest.approx([0, 0], abs=0.01)
    assert math.remainder(pose.heading_rad - heading, 2 * math.pi) == pytest.approx(0, abs=1e-6)
    assert pose.altitude_m == pytest.approx(20.0, abs=0.05)


def test_noise_that_is_new_with_every_fix_is_averaged_away_and_the_pose_knows() -> None:
    pose = driven(0.7, frames=600, noise_m=1.0)
    ahead, left = np.array([math.sin(0.7), math.cos(0.7)]), np.array([-math.cos(0.7), math.sin(0.7)])
    assert np.linalg.norm(error_m(pose, 0.7, 600)) < 0.6
    assert math.sqrt(left @ pose.covariance_m2 @ left) < 0.4
    # At one speed on a straight road nothing tells how old fixes are, of which 0.1 s is allowed for.
    assert math.sqrt(ahead @ pose.covariance_m2 @ ahead) < 0.1 * SPEED_MPS


def test_a_bias_that_all_fixes_share_stays_and_the_pose_says_how_unsure_it_is() -> None:
    pose = driven(0.7, bias_m=(1.5, -0.8), frames=600)
    assert error_m(pose, 0.7, 600) == pytest.approx([1.5, -0.8], abs=0.1)
    assert 0.8 < pose.sd_m <= 1.05


@settings(max_examples=15, deadline=None)
@given(st.floats(-0.05, 0.05), st.floats(-4, 4))
def test_headings_around_north_have_no_seam(heading_rad: float, odom_yaw_rad: float) -> None:
    pose = driven(heading_rad, frames=40, heading_noise_rad=0.02, odom_yaw_rad=odom_yaw_rad)
    assert abs(math.remainder(pose.heading_rad - heading_rad, 2 * math.pi)) < 0.03
    assert 0 <= pose.heading_rad < 2 * math.pi


def test_between_fixes_odometry_carries_the_pose() -> None:
    state, _ = update(PoseFilter(), frame_at(NOON_S, planar(5, 5, 0.0), fix_at(0, 0, EAST)))
    _, found = update(state, frame_at(NOON_S + 1, planar(15, 5, 0.0), None))
    assert east_north_m(found) == pytest.approx([10, 0], abs=1e-3)
    assert found.pose is not None
    assert found.pose.odom_from_vehicle == pytest.approx(planar(15, 5, 0.0), abs=1e-9)


@settings(max_examples=25, deadline=None)
@given(st.floats(0.0, 0.9), st.floats(-math.pi, math.pi), st.integers(0, 5))
def test_a_late_fix_counts_where_the_car_was(late_s: float, odom_yaw_rad: float, seed: int) -> None:
    """Fixes that arrive late, and out of order, at 10 m/s: taken for fresh ones they would be metres behind."""
    random = np.random.default_rng(seed)
    state, found = PoseFilter(), PoseUpdate(None, None)
    for number in range(40):
        delay_s = late_s * random.uniform(0.5, 1.0)
        fix = fix_at(number - SPEED_MPS * delay_s, 0, EAST, stamp_s=NOON_S + number / RATE_HZ - delay_s)
        odom_from_vehicle = planar(0, 0, odom_yaw_rad) @ planar(number, 0, 0.0)
        state, found = update(state, frame_at(NOON_S + number / RATE_HZ, odom_from_vehicle, fix))
    assert east_north_m(found) == pytest.approx([39, 0], abs=0.05)


def test_a_fix_stamped_after_its_frame_waits_for_its_moment() -> None:
    state, _ = along_x(10)
    ahead = fix_at(10.5, 0, EAST, stamp_s=NOON_S + 1.05)
    state, _ = update(state, frame_at(NOON_S + 1.0, planar(10, 0, 0.0), ahead))
    assert state.last_fix_s == pytest.approx(NOON_S + 0.9)
    state, found = update(state, frame_at(NOON_S + 1.1, planar(11, 0, 0.0), None))
    assert state.last_fix_s == pytest.approx(NOON_S + 1.05)
    assert east_north_m(found) == pytest.approx([11, 0], abs=0.01)


def test_a_receiver_whose_clock_is_off_is_named() -> None:
    state, found = PoseFilter(), PoseUpdate(None, None)
    for number in range(30):
        fix = fix_at(number, 0, EAST, stamp_s=NOON_S + number / RATE_HZ - 3600)
        state, found = update(state, frame_at(NOON_S + number / RATE_HZ, planar(number, 0, 0.0), fix))
    assert found == PoseUpdate(None, "the satellite fixes' clock is 3600 s off")


def test_a_clock_that_is_set_back_costs_no_pose() -> None:
    state, _ = along_x(50)
    for number in range(50, 60):
        fix = fix_at(number, 0, EAST)
        state, found = update(state, frame_at(NOON_S - 100 + number / RATE_HZ, planar(number, 0, 0.0), fix))
        assert east_north_m(found) == pytest.approx([number, 0], abs=0.05)


def test_without_a_compass_the_heading_comes_from_the_way_between_fixes() -> None:
    state, short = along_x(5, heading=None)
    assert short == PoseUpdate(None, "heading unknown: drive on")
    _, found = along_x(60, first=5, state=state, heading=None)
    assert found.pose is not None
    assert found.pose.heading_rad == pytest.approx(EAST, abs=1e-3)
    assert found.pose.heading_sd_rad < 0.1


@pytest.mark.parametrize("backwards", [False, True])
def test_the_course_tells_the_heading_also_in_reverse(backwards: bool) -> None:
    state, found = PoseFilter(), PoseUpdate(None, None)
    for number in range(20):
        x_m = -number if backwards else number
        fix = replace(fix_at(x_m, 0, None), course_rad=3 * EAST if backwards else EAST, speed_mps=SPEED_MPS)
        state, found = update(state, frame_at(NOON_S + number / RATE_HZ, planar(x_m, 0, 0.0), fix))
    assert found.pose is not None
    assert found.pose.heading_rad == pytest.approx(EAST, abs=1e-3)


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("stated_mps", [None, SPEED_MPS])
def test_the_speed_of_a_car_that_backs_is_below_0_also_where_it_is_stated_without_a_sign(
    backwards: bool, stated_mps: float | None
) -> None:
    state, found = PoseFilter(), PoseUpdate(None, None)
    for number in range(5):
        x_m = -number if backwards else number
        frame = replace(
            frame_at(NOON_S + number / RATE_HZ, planar(x_m, 0, 0.0), fix_at(x_m, 0, EAST)), speed_mps=stated_mps
        )
        state, found = update(state, frame)
    assert found.pose is not None
    assert found.pose.speed_mps == pytest.approx(-SPEED_MPS if backwards else SPEED_MPS, rel=1e-5)


def test_in_a_roundabout_the_pose_knows_its_bend_and_the_course_does_not_pull_the_heading() -> None:
    state, found = PoseFilter(), PoseUpdate(None, None)
    radius_m, rate = 20.0, SPEED_MPS / 20.0
    for number in range(200):
        yaw = rate * number / RATE_HZ
        place = radius_m * np.array([math.sin(yaw), 1 - math.cos(yaw)])
        fix = replace(fix_at(*place, None), course_rad=(EAST - yaw) % (2 * math.pi), speed_mps=SPEED_MPS)
        state, found = update(state, frame_at(NOON_S + number / RATE_HZ, planar(*place, yaw), fix))
    assert found.pose is not None
    assert math.remainder(yaw_of(found.pose.enu_from_vehicle) - yaw, 2 * math.pi) == pytest.approx(0, abs=0.01)
    assert found.pose.bend.curvature_per_m == pytest.approx(1 / radius_m, rel=0.01)


def test_the_antenna_s_place_on_the_car_is_taken_out() -> None:
    antenna_m = np.array([-1.5, 0.4, 1.6])
    state, found = PoseFilter(antenna_m=antenna_m), PoseUpdate(None, None)
    for number in range(30):
        fix = fix_at(number + antenna_m[0], antenna_m[1], EAST)
        state, found = update(state, frame_at(NOON_S + number / RATE_HZ, planar(number, 0, 0.0), fix))
    assert east_north_m(found) == pytest.approx([29, 0], abs=1e-2)
    assert found.pose is not None
    assert found.pose.altitude_m == pytest.approx(20 - 1.6, abs=1e-2)


def test_an_antenna_that_the_source_has_taken_out_is_not_taken_out_again() -> None:
    state, found = PoseFilter(antenna_m=np.array([-1.5, 0.4, 1.6])), PoseUpdate(None, None)
    for number in range(30):
        fix = replace(fix_at(number, 0, EAST), antenna_m=OF_VEHICLE)
        state, found = update(state, frame_at(NOON_S + number / RATE_HZ, planar(number, 0, 0.0), fix))
    assert east_north_m(found) == pytest.approx([29, 0], abs=1e-2)
    assert found.pose is not None
    assert found.pose.altitude_m == pytest.approx(20, abs=1e-2)


def test_all_fixes_that_a_frame_brings_count() -> None:
    state, found = PoseFilter(), PoseUpdate(None, None)
    random = np.random.default_rng(3)
    for number in range(60):
        fixes = [
            replace(
                fix_at(*(np.array([number - late, 0]) + random.normal(0, 1, 2)), EAST),
                stamp_s=NOON_S + (number - late) / RATE_HZ,
            )
            for late in np.arange(9, -1, -1) / 10
        ]
        frame = replace(
            frame_at(NOON_S + number / RATE_HZ, planar(number, 0, 0.0), fixes[-1]), earlier_fixes=tuple(fixes[:-1])
        )
        state, found = update(state, frame)
    assert found.pose is not None
    # The mean of 600 fixes errs by 4 cm, that of the last ones by 13 cm.
    assert math.sqrt(found.pose.covariance_m2[1, 1]) < 0.5
    assert east_north_m(found)[1] == pytest.approx(0, abs=0.2)


def test_a_report_carries_the_pose_s_covariance_also_between_east_and_north() -> None:
    unsure = replace(pose_at(), covariance_m2=np.array([[2.0, 0.5], [0.5, 1.0]]))
    report = compose_report(UUID(int=1), unsure, [], [], pseudonym="car", sensor="test")
    covariance = report.origin.covariance
    assert (covariance.east_m2, covariance.north_m2, covariance.east_north_m2) == (2.0, 1.0, 0.5)


def test_a_drive_without_satellites_goes_on_from_a_stated_place_and_says_so() -> None:
    state = PoseFilter(stated=StatedPlace(ORIGIN, EAST))
    state, begun = without_fixes(state, 0, 1)
    state, found = without_fixes(state, 1, 200)
    assert begun.reason == found.reason == ODOMETRY_ALONE
    assert east_north_m(found) == pytest.approx([200, 0], abs=0.1)
    assert begun.pose is not None and found.pose is not None  # noqa: PT018
    assert found.pose.sd_m > 10 * begun.pose.sd_m
    _, far = without_fixes(state, 201, 300)
    assert far.pose is None
    assert far.reason is not None
    assert far.reason.startswith("place unsure")


@pytest.mark.parametrize(("x_m", "after_s"), [(-40.0, 0.1), (12.0, 2.0)])
def test_a_stated_place_ends_where_odometry_begins_anew(x_m: float, after_s: float) -> None:
    """Nobody knows the way from there: a car that goes on from where odometry put it is another place's."""
    state, _ = without_fixes(PoseFilter(stated=StatedPlace(ORIGIN, EAST)), 0, 11)
    _, found = update(state, frame_at(NOON_S + 1.0 + after_s, planar(x_m, 0, 0.0), None))
    assert found == PoseUpdate(None, "no satellite fix yet")


def test_a_fix_ends_the_drive_on_a_stated_place() -> None:
    state, _ = without_fixes(PoseFilter(stated=StatedPlace(ORIGIN, 0.0)), 0, 10)
    _, found = along_x(1, first=10, state=state)
    assert found.reason is None
    assert east_north_m(found) == pytest.approx([10, 0], abs=0.01)


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
        stamp_s = NOON_S + 1_000 + number / 10
        state, found = update(state, frame_at(stamp_s, planar(30_000 + x_m, 0.0, 0.0), fix))
    assert found.pose is not None
    assert far.enu(found.pose.position, found.pose.altitude_m) == pytest.approx([x_m, 0.0, 0.0], abs=0.1)


def test_no_pose_jumps_where_the_origin_follows_the_car() -> None:
    state, before = PoseFilter(), None
    for number in range(800):
        x_m = 1.5 * number
        state, found = update(state, frame_at(NOON_S + number / 10, planar(x_m, 0, 0.0), fix_at(x_m, 0, EAST)))
        pose = found.pose
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
