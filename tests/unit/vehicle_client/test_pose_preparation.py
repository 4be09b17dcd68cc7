"""A frame is put in order before anything looks at it: clocks, odometry, points of one moment."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.unit.vehicle_client.making import NOON_S, PATRAS, camera_ahead, planar
from vehicle_client.ar.camera import project
from vehicle_client.frames import Matrix, apply, inverse, rigid, rotation_about_z
from vehicle_client.sensing.calibration import VehicleCalibration
from vehicle_client.sensing.calibration_file import CarCalibration
from vehicle_client.sensing.deskew import Spin
from vehicle_client.sensing.preparation import Preparation
from vehicle_client.sensing.time_alignment import IMAGE_LASTS_S, SensorDelays, aligned
from vehicle_client.sources.frame import GnssFix, LidarFrame, Motion

# A LiDAR ahead of the axle that looks to the left: its lever and its axes both count.
MAST = rigid(rotation_about_z(0.7), np.array([1.2, 0.3, 1.7]))
CAR = CarCalibration(VehicleCalibration(MAST, "test"))
IMAGE = np.zeros((4, 4, 3), dtype=np.uint8)
SPEED_MPS, YAW_RATE = 14.0, 0.4


def odom_at(seconds: float) -> Matrix:
    """An arc at constant speed and rate."""
    radius, yaw = SPEED_MPS / YAW_RATE, YAW_RATE * seconds
    return planar(radius * math.sin(yaw), radius * (1 - math.cos(yaw)), yaw)


def swept(things: np.ndarray, times: np.ndarray, end_s: float) -> np.ndarray:
    """What a LiDAR on the arc measures of standing things, each at its time before the end."""
    return np.array(
        [apply(inverse(odom_at(end_s + t) @ MAST), p) for t, p in zip(times, things, strict=True)], dtype=np.float32
    )


def test_points_of_a_curve_come_out_as_seen_at_the_stamp() -> None:
    random, preparation = np.random.default_rng(1), Preparation(CAR)
    things = random.uniform(-30, 30, (200, 3))
    times = random.uniform(-0.1, 0.0, 200).astype(np.float32)
    for k in range(3):
        raw = swept(things, times, k / 10)
        came = LidarFrame(NOON_S + k / 10, raw, odom_from_vehicle=odom_at(k / 10), point_time_s=times)
        frame = preparation.prepared(came)
    expected = apply(inverse(odom_at(0.2) @ MAST), things)
    assert np.abs(raw - expected).max() > 1.0
    assert np.abs(frame.points_m - expected).max() < 1e-3
    assert frame.point_time_s is None


def test_the_calibration_s_spin_stands_in_for_times() -> None:
    spun = replace(CAR, spin=Spin(10.0, clockwise=True))
    preparation, known = Preparation(spun), Preparation(CAR)
    points = np.random.default_rng(2).uniform(-20, 20, (100, 3)).astype(np.float32)
    for k in range(2):
        frame = LidarFrame(NOON_S + k / 10, points, odom_from_vehicle=odom_at(k / 10))
        by_spin = preparation.prepared(frame)
        by_times = known.prepared(replace(frame, point_time_s=Spin(10.0).point_time_s(points)))
        untouched = Preparation(CAR).prepared(frame)
    assert np.array_equal(by_spin.points_m, by_times.points_m)
    assert not np.array_equal(by_spin.points_m, untouched.points_m)
    assert np.array_equal(untouched.points_m, points)


@pytest.mark.parametrize("lost", [None, np.full((4, 4), np.nan)])
def test_without_odometry_points_stay_as_they_came(lost: Matrix | None) -> None:
    preparation = Preparation(CAR)
    points, times = np.ones((3, 3), dtype=np.float32), np.full(3, -0.05, dtype=np.float32)
    preparation.prepared(LidarFrame(NOON_S, points, odom_from_vehicle=odom_at(0.0), point_time_s=times))
    came = LidarFrame(NOON_S + 0.1, points, odom_from_vehicle=lost, point_time_s=times)
    assert np.array_equal(preparation.prepared(came).points_m, points)
    after = LidarFrame(NOON_S + 0.2, points, odom_from_vehicle=odom_at(0.2), point_time_s=times)
    assert np.array_equal(preparation.prepared(after).points_m, points)


def test_times_that_are_not_as_many_as_points_are_not_used() -> None:
    preparation, points = Preparation(CAR), np.ones((3, 3), dtype=np.float32)
    for k in range(2):
        came = LidarFrame(
            NOON_S + k / 10, points, odom_from_vehicle=odom_at(k / 10), point_time_s=np.zeros(2, np.float32)
        )
        frame = preparation.prepared(came)
    assert np.array_equal(frame.points_m, points)


def test_a_frame_without_a_time_spoils_none_after_it() -> None:
    preparation, empty = Preparation(CAR), np.empty((0, 3), np.float32)
    for stamp_s in (math.nan, NOON_S, math.inf, NOON_S + 0.1):
        said = (Motion(stamp_s, 5.0, 0.0),)
        frame = preparation.prepared(LidarFrame(stamp_s, empty, motions=said))
    assert frame.odom_from_vehicle is not None
    assert frame.odom_from_vehicle[0, 3] == pytest.approx(0.5)


def test_wheels_give_the_odometry_that_a_source_does_not() -> None:
    preparation = Preparation(CAR)
    for k in range(11):
        said = (Motion(NOON_S + k / 10, 5.0, 0.0),)
        frame = preparation.prepared(LidarFrame(NOON_S + k / 10, np.empty((0, 3), np.float32), motions=said))
    assert frame.odom_from_vehicle is not None
    assert frame.odom_from_vehicle[0, 3] == pytest.approx(5.0, abs=0.6)


def test_a_picture_taken_earlier_is_drawn_upon_from_where_its_camera_was() -> None:
    camera, preparation = camera_ahead(640, 480, 60.0), Preparation(CAR)
    for k in range(2):
        came = LidarFrame(
            NOON_S + k / 10,
            np.empty((0, 3), np.float32),
            odom_from_vehicle=odom_at(k / 10),
            image=IMAGE,
            image_stamp_s=NOON_S + k / 10 - 0.06,
        )
        frame = preparation.prepared(came)
    thing = np.array([25.0, 2.0, 0.0])
    shown, _ = project(preparation.camera_at_image(frame, camera), apply(inverse(odom_at(0.1)), thing)[None])
    expected, _ = project(camera, apply(inverse(odom_at(0.04)), thing)[None])
    assert shown == pytest.approx(expected, abs=0.02)


def test_without_motion_or_stamp_the_camera_stays() -> None:
    camera, preparation = camera_ahead(640, 480, 60.0), Preparation(CAR)
    frame = preparation.prepared(LidarFrame(NOON_S, np.empty((0, 3), np.float32), odom_from_vehicle=np.eye(4)))
    assert preparation.camera_at_image(frame, camera) is camera


def test_delays_are_taken_out_of_every_stamp() -> None:
    fix = GnssFix(PATRAS, 10.0, None, 1.0, 2.0)
    came = LidarFrame(
        NOON_S,
        np.empty((0, 3), np.float32),
        image=IMAGE,
        image_stamp_s=NOON_S + 0.02,
        gnss=fix,
        motions=(Motion(NOON_S, 5.0),),
    )
    came = replace(came, earlier_fixes=(replace(fix, stamp_s=NOON_S - 0.2),))
    frame = aligned(came, SensorDelays(gnss_s=0.095, camera_s=0.03, motion_s=0.01))
    assert [f.stamp_s for f in frame.earlier_fixes] == [pytest.approx(NOON_S - 0.295)]
    assert frame.gnss is not None
    assert frame.gnss.stamp_s == pytest.approx(NOON_S - 0.095)
    assert frame.image_stamp_s == pytest.approx(NOON_S - 0.01)
    assert frame.motions[0].stamp_s == pytest.approx(NOON_S - 0.01)
    assert aligned(came, SensorDelays()).gnss is fix


@pytest.mark.parametrize(("age_s", "kept"), [(0.0, True), (IMAGE_LASTS_S - 0.01, True), (IMAGE_LASTS_S + 0.01, False)])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_picture_of_another_time_is_not_drawn_upon(age_s: float, kept: bool, sign: int) -> None:
    came = LidarFrame(NOON_S, np.empty((0, 3), np.float32), image=IMAGE, image_stamp_s=NOON_S - sign * age_s)
    assert (aligned(came, SensorDelays()).image is not None) is kept


def test_a_stamp_that_is_no_number_is_the_frame_s() -> None:
    came = LidarFrame(NOON_S, np.empty((0, 3), np.float32), image=IMAGE, image_stamp_s=math.nan)
    assert aligned(came, SensorDelays()).image_stamp_s == NOON_S
