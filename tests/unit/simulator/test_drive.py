from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from simulator.camera import CameraModel
from simulator.drive import DrivePlan, DriveSample, Wander, drive
from simulator.lidar import LidarModel
from simulator.world import World

SMALL = LidarModel(channels=8, points_per_second=24_000)
PLAN = DrivePlan(start_x_m=100.0, end_x_m=160.0, speed_mps=14.0, seed=1, every_nth=3, lidar=SMALL)


@pytest.fixture(scope="module")
def samples(world: World) -> list[DriveSample]:
    return list(drive(world, PLAN))


def test_a_drive_knows_its_length_and_keeps_time_and_speed(world: World, samples: list[DriveSample]) -> None:
    assert len(drive(world, PLAN)) == len(samples) == math.floor(60 / 1.4) + 1
    assert np.diff([s.stamp_s for s in samples]) == pytest.approx(0.1, abs=1e-6)
    steps = np.diff([s.street_from_vehicle[0, 3] for s in samples])
    assert steps == pytest.approx(1.4)


def test_the_same_plan_gives_the_same_bytes(world: World, samples: list[DriveSample]) -> None:
    for one, again in zip(samples[:5], drive(world, PLAN), strict=False):
        assert one.points_m.tobytes() == again.points_m.tobytes()
        assert one.odom_from_vehicle.tobytes() == again.odom_from_vehicle.tobytes()
        assert one.gnss == again.gnss


def test_the_exact_pose_is_that_of_the_street_in_enu(world: World, samples: list[DriveSample]) -> None:
    for sample in samples:
        assert sample.enu_from_vehicle == pytest.approx(world.street.enu_from_street @ sample.street_from_vehicle)
        assert sample.enu_from_vehicle[:3, :3] @ sample.enu_from_vehicle[:3, :3].T == pytest.approx(np.eye(3))


def test_the_car_stands_on_the_road_and_leans_with_its_crown(world: World, samples: list[DriveSample]) -> None:
    for sample in samples:
        _, y, z = sample.street_from_vehicle[:3, 3]
        assert z == pytest.approx(float(world.street.sound_height(np.zeros(1), np.array([y]))[0]), abs=1e-3)
        assert abs(y + 1.75) <= 0.081
        left = sample.street_from_vehicle[2, 1]
        assert left == pytest.approx(
            world.street.main.cross_slope(np.zeros(1), np.array([y]))[0], abs=math.radians(0.5)
        )


def test_odometry_starts_at_the_vehicle_and_drifts_slowly(samples: list[DriveSample]) -> None:
    assert samples[0].odom_from_vehicle[:3, 3] == pytest.approx(np.zeros(3))
    first, last = samples[0], samples[-1]
    true_way = np.linalg.norm(last.street_from_vehicle[:3, 3] - first.street_from_vehicle[:3, 3])
    believed_way = np.linalg.norm(last.odom_from_vehicle[:3, 3])
    assert believed_way != true_way
    assert believed_way == pytest.approx(true_way, rel=0.004)
    for before, after in itertools.pairwise(samples):
        truth = np.linalg.inv(before.street_from_vehicle) @ after.street_from_vehicle
        belief = np.linalg.inv(before.odom_from_vehicle) @ after.odom_from_vehicle
        assert belief[:3, 3] == pytest.approx(truth[:3, 3], abs=0.01)
        assert belief[:3, :3] == pytest.approx(truth[:3, :3], abs=math.radians(0.02) * 6)


def test_without_errors_odometry_is_the_truth(world: World) -> None:
    exact = Wander(odometry_scale_sd=0.0, odometry_yaw_sd_rad_per_m=0.0, attitude_sd_rad=0.0)
    samples = list(drive(world, replace(PLAN, end_x_m=120.0, wander=exact)))
    odom_from_street = samples[0].odom_from_vehicle @ np.linalg.inv(samples[0].street_from_vehicle)
    for sample in samples:
        assert odom_from_street @ sample.street_from_vehicle == pytest.approx(sample.odom_from_vehicle, abs=1e-9)


def test_gnss_errs_by_one_bias_a_drive_and_little_noise(world: World) -> None:
    reference = world.street.georeference
    biases, noises, headings = [], [], []
    tiny = replace(PLAN, end_x_m=112.0, lidar=LidarModel(channels=1, points_per_second=60))
    for seed in range(150):
        drive_samples = list(drive(world, replace(tiny, seed=seed)))
        errors = np.array(
            [
                reference.enu_from_geodetic(s.gnss.position, s.gnss.altitude_m) - s.enu_from_vehicle[:3, 3]
                for s in drive_samples
            ]
        )
        biases.append(errors.mean(axis=0))
        noises.append((errors - errors.mean(axis=0))[:, :2])
        headings += [
            s.gnss.heading_rad - (math.pi / 2 - math.atan2(s.enu_from_vehicle[1, 0], s.enu_from_vehicle[0, 0]))
            for s in drive_samples
        ]
    assert np.std(np.array(biases)[:, :2]) == pytest.approx(1.0, rel=0.15)
    count = len(drive_samples)
    assert np.std(np.concatenate(noises)) == pytest.approx(0.1 * math.sqrt(1 - 1 / count), rel=0.1)
    assert np.degrees(np.std(headings)) == pytest.approx(0.3, rel=0.1)
    assert drive_samples[0].gnss.sd_m == pytest.approx(math.hypot(1.0, 0.1))


def test_steering_turns_the_way_the_car_does(samples: list[DriveSample]) -> None:
    yaw = np.unwrap([math.atan2(s.street_from_vehicle[1, 0], s.street_from_vehicle[0, 0]) for s in samples])
    yaw_rate = np.gradient(yaw, 0.1)[1:-1]
    expected = np.tan([s.steering_rad for s in samples])[1:-1] / 2.7 * 14.0
    assert yaw_rate == pytest.approx(expected, abs=0.002)


def test_pictures_come_only_with_a_camera(world: World, samples: list[DriveSample]) -> None:
    assert all(sample.image is None for sample in samples)
    plan = replace(PLAN, end_x_m=100.0, camera=CameraModel(width_px=64, height_px=36))
    (only,) = drive(world, plan)
    assert only.image is not None
    assert only.image.shape == (36, 64, 3)


def test_a_plan_that_ends_before_it_starts_is_empty(world: World) -> None:
    assert list(drive(world, replace(PLAN, end_x_m=50.0))) == []
