from __future__ import annotations

import itertools
import math
from typing import TypeVar

import numpy as np
import pytest

from simulator.changes import Worlds
from simulator.drive import Drive, tick_of
from simulator.mesh import pose
from simulator.readings import EgoFrame, GnssReading, ImageReading, ImuReading, LidarReading, SensorName
from simulator.record import drive_of
from simulator.scenario import Scenario, ScenarioPlan, scenario
from simulator.sensors.camera import CameraModel, forward_camera
from simulator.sensors.gnss import GnssModel
from simulator.sensors.imu import ImuModel
from simulator.sensors.instruments import Schedule
from simulator.sensors.lidar import LidarModel
from simulator.sensors.odometry import OdometryModel
from simulator.sensors.sensor_config import RigSensor, SensorRig
from simulator.streets.world_plan import WorldPlan

SMALL = LidarModel(channels=8, points_per_second=24_000, rate_hz=10.0)
PLAN = ScenarioPlan(seed=5, egos=2, seconds=2.0, world=WorldPlan(side_roads=False, features_per_100m=0.0))


def rig(*, camera: bool = False) -> SensorRig:
    def sensor(kind: str, model: object, z_m: float, tick_s: float) -> RigSensor:
        return RigSensor(SensorName(f"sensor.{kind}", kind), model, pose(0.0, 0.0, z_m), tick_s, {})  # type: ignore[arg-type]

    sensors = [
        sensor("lidar.ray_cast", SMALL, 2.0, 0.0),
        sensor("other.gnss", GnssModel(), 1.5, 0.2),
        sensor("other.imu", ImuModel(), 0.5, 0.02),
    ]
    if camera:
        eye = CameraModel(64, 32, vehicle_from_camera=forward_camera(0.6, 1.6, 0.0))
        sensors.append(sensor("camera.rgb", eye, 1.6, 0.5))
        sensors.append(sensor("camera.semantic_segmentation", eye, 1.6, 0.5))
    return SensorRig(tuple(sensors))


@pytest.fixture(scope="module")
def happening() -> Scenario:
    return scenario(PLAN)


@pytest.fixture(scope="module")
def frames(happening: Scenario) -> list[EgoFrame]:
    return list(drive_of(happening, 1, rig(camera=True)))


T = TypeVar("T")


def readings(frames: list[EgoFrame], kind: type[T]) -> list[T]:
    return [reading for frame in frames for reading in frame.readings if isinstance(reading, kind)]


def test_a_frame_is_a_turn_of_the_lidar_and_all_egos_count_the_same_ticks(
    happening: Scenario, frames: list[EgoFrame]
) -> None:
    assert tick_of(rig()) == pytest.approx(0.1)
    assert len(frames) == 20
    assert frames[0].time_s >= happening.egos[1].start_s > 0
    for frame in frames:
        assert frame.time_s == pytest.approx(frame.number * 0.1)


def test_each_sensor_measures_at_its_own_times_and_a_reading_belongs_to_the_next_frame(frames: list[EgoFrame]) -> None:
    assert len(readings(frames, LidarReading)) == 20
    assert len(readings(frames, GnssReading)) == 10
    assert len(readings(frames, ImuReading)) == 100
    assert len(readings(frames, ImageReading)) == 8
    assert np.diff([r.time_s for r in readings(frames, ImuReading)]) == pytest.approx(0.02)
    for frame in frames:
        for reading in readings([frame], ImuReading):
            assert frame.time_s - 0.1 < reading.time_s <= frame.time_s + 1e-9


def test_the_same_plan_gives_the_same_bytes(happening: Scenario, frames: list[EgoFrame]) -> None:
    for one, again in zip(frames[:4], drive_of(happening, 1, rig(camera=True)), strict=False):
        assert one.odom_from_vehicle.tobytes() == again.odom_from_vehicle.tobytes()
        for reading, repeated in zip(one.readings, again.readings, strict=True):
            if isinstance(reading, LidarReading) and isinstance(repeated, LidarReading):
                assert reading.sweep.points_m.tobytes() == repeated.sweep.points_m.tobytes()
            if isinstance(reading, ImageReading) and isinstance(repeated, ImageReading):
                assert reading.pixels.tobytes() == repeated.pixels.tobytes()


def test_one_sensor_more_changes_nothing_for_the_others(happening: Scenario, frames: list[EgoFrame]) -> None:
    without = next(iter(drive_of(happening, 1, rig())))
    (one,), (other,) = readings([without], LidarReading), readings(frames[:1], LidarReading)
    assert one.sweep.points_m.tobytes() == other.sweep.points_m.tobytes()


def test_the_exact_pose_is_that_of_the_street_in_enu(happening: Scenario, frames: list[EgoFrame]) -> None:
    for frame in frames:
        expected = happening.changing.street.enu_from_street @ frame.street_from_vehicle
        assert frame.enu_from_vehicle == pytest.approx(expected)
        assert frame.enu_from_vehicle[:3, :3] @ frame.enu_from_vehicle[:3, :3].T == pytest.approx(np.eye(3))


def test_the_car_drives_on_the_road_at_its_speed_and_leans_with_it(happening: Scenario, frames: list[EgoFrame]) -> None:
    street = happening.changing.street
    for before, after in itertools.pairwise(frames):
        step = np.linalg.norm(after.street_from_vehicle[:3, 3] - before.street_from_vehicle[:3, 3])
        assert step == pytest.approx(0.1 * (before.speed_mps + after.speed_mps) / 2, rel=0.02)
    for frame in frames:
        place = frame.street_from_vehicle[:3, 3]
        assert place[2] == pytest.approx(street.sound_height(place[:1], place[1:2])[0], abs=0.01)
        s, t = street.main.line.project(place[None, :2])
        assert frame.street_from_vehicle[2, 1] == pytest.approx(
            street.main.cross_slope(s, t)[0], abs=math.radians(0.5) + 0.005
        )


def test_labels_say_what_lies_under_each_point(happening: Scenario, frames: list[EgoFrame]) -> None:
    street = happening.changing.street
    for reading in readings(frames[::5], LidarReading):
        points = reading.sweep.points_m.astype(float)
        in_street = points @ reading.street_from_sensor[:3, :3].T + reading.street_from_sensor[:3, 3]
        road = reading.sweep.surface == 1
        height = street.sound_height(in_street[road, 0], in_street[road, 1])
        sound = reading.sweep.obstacle_id[road] == 0
        assert np.abs(in_street[road, 2] - height)[sound].max() < 0.10
        assert (reading.sweep.mover_id[road] == 0).all()
        assert set(np.unique(reading.sweep.surface[reading.sweep.mover_id > 0])) <= {8, 9, 15}


def test_no_vehicle_sees_itself(happening: Scenario, frames: list[EgoFrame]) -> None:
    own = happening.egos[1].mover
    assert all(own not in reading.sweep.mover_id for reading in readings(frames, LidarReading))


def test_odometry_starts_at_the_vehicle_and_drifts_slowly(frames: list[EgoFrame]) -> None:
    assert frames[0].odom_from_vehicle[:3, 3] == pytest.approx(np.zeros(3))
    for before, after in itertools.pairwise(frames):
        truth = np.linalg.inv(before.street_from_vehicle) @ after.street_from_vehicle
        belief = np.linalg.inv(before.odom_from_vehicle) @ after.odom_from_vehicle
        assert belief[:3, 3] == pytest.approx(truth[:3, 3], abs=0.01)
        assert belief[:3, :3] == pytest.approx(truth[:3, :3], abs=math.radians(0.02) * 6)


def test_without_errors_odometry_is_the_truth(happening: Scenario) -> None:
    worlds = Worlds(happening.changing, lambda _: pytest.fail("nothing looks at the world"))
    instruments = SensorRig(rig().sensors[1:])
    exact = OdometryModel(0.0, 0.0, 0.0)
    frames = list(Drive(worlds, happening.egos[0], instruments, seed=1, seconds=2.0, tick_s=0.1, odometry=exact))
    odom_from_street = frames[0].odom_from_vehicle @ np.linalg.inv(frames[0].street_from_vehicle)
    for frame in frames:
        assert odom_from_street @ frame.street_from_vehicle == pytest.approx(frame.odom_from_vehicle, abs=1e-9)


def test_steering_turns_the_way_the_car_does(happening: Scenario) -> None:
    trajectory = happening.egos[0].trajectory
    times = np.arange(0.0, 2.0, 0.02)
    poses = trajectory.poses(times)
    yaw_rate = np.gradient(np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0])), 0.02)[1:-1]
    expected = (np.tan(trajectory.steering(times)) / 2.7 * trajectory.speed(times))[1:-1]
    assert yaw_rate == pytest.approx(expected, abs=0.004)


def test_pictures_and_their_tags_show_the_same_moment(frames: list[EgoFrame]) -> None:
    colours = [r for r in readings(frames, ImageReading) if r.pixels.ndim == 3]
    tags = [r for r in readings(frames, ImageReading) if r.pixels.ndim == 2]
    assert len(colours) == len(tags) == 4
    for colour, tag in zip(colours, tags, strict=True):
        assert colour.pixels.shape == (32, 64, 3)
        assert (tag.pixels[-1] == 1).mean() > 0.5  # the road lies ahead, CARLA's tag 1
        assert (colour.street_from_sensor == tag.street_from_sensor).all()


def test_a_schedule_without_a_period_is_once_a_frame_and_loses_no_time() -> None:
    assert Schedule(0.1, 0.0).times(7) == pytest.approx([0.7])
    slow = [Schedule(1 / 30, 0.1).times(frame).size for frame in range(1, 31)]
    assert sum(slow) == 10
    assert slow[2::3] == [1] * 10
    fast = np.concatenate([Schedule(1 / 30, 0.01).times(frame) for frame in range(1, 31)])
    assert fast == pytest.approx(np.arange(1, 101) * 0.01)
