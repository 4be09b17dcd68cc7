"""The bags that `write_bag` makes, as somebody reads them who knows ROS and not this program."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from simulator.sensors.odometry import Odometer, OdometryModel
from tests.unit.vehicle_client.making import NOON_S, PATRAS, planar
from vehicle_client.frames import rigid
from vehicle_client.recording.ros_bag import write_bag
from vehicle_client.recording.ros_covariances import NOT_MEASURED
from vehicle_client.sources.frame import GnssFix, LidarFrame
from vehicle_client.sources.opening import open_source

STORE = get_typestore(Stores.ROS2_HUMBLE)
STEP_M = 1.4
FRAMES = 110
SPEED_MPS = 14.0
VEHICLE_FROM_SENSOR = planar(1.1, -0.2, 0.05, 1.9)
SENSORS = {"lidar", "gnss", "imu"}


def frame(index: int, odom_from_vehicle: np.ndarray) -> LidarFrame:
    return LidarFrame(
        NOON_S + 0.1 * index,
        np.ones((3, 3), np.float32),
        odom_from_vehicle=odom_from_vehicle,
        gnss=GnssFix(PATRAS, 20.0, 1.25, 0.7, 1.5),
        speed_mps=SPEED_MPS,
        point_time_s=np.array([-0.1, -0.05, 0.0], np.float32),
    )


def driven(seed: int) -> list[LidarFrame]:
    """150 m straight ahead, by the simulator's wheels and gyro."""
    odometer = Odometer(OdometryModel(), np.random.default_rng(seed))
    return [frame(i, odometer.measure(planar(STEP_M * i, 0.0, 0.0))) for i in range(FRAMES)]


def said(bag: Path, topic: str) -> list[Any]:
    """All messages of a topic."""
    with Reader(bag) as reader:
        return [STORE.deserialize_cdr(data, c.msgtype) for c, _, data in reader.messages() if c.topic == topic]


def bag_of(folder: Path, frames: Iterable[LidarFrame]) -> Path:
    return write_bag(folder / "bag", frames, VEHICLE_FROM_SENSOR)


def matrix_of(transform: Any) -> np.ndarray:
    at, turn = transform.translation, transform.rotation
    rotation = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    return rigid(rotation, np.array([at.x, at.y, at.z]))


def matrix(covariance: np.ndarray) -> np.ndarray:
    side = math.isqrt(len(covariance))
    return covariance.reshape(side, side)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bag_of(tmp_path_factory.mktemp("bag"), driven(0))


def test_a_bag_states_what_its_unit_does_not_measure(bag: Path) -> None:
    for message in said(bag, "/imu/data"):
        for covariance in (message.angular_velocity_covariance, message.linear_acceleration_covariance):
            assert covariance.tolist() == [-1.0, *[0.0] * 8]
        roll, pitch, yaw = np.sqrt(np.diag(matrix(message.orientation_covariance)))
        assert roll == pitch > 5 * yaw > 0


def test_of_the_velocity_wheels_measure_what_is_forward_only(bag: Path) -> None:
    for message in said(bag, "/odom"):
        assert message.twist.twist.linear.x == SPEED_MPS
        forward, *others = np.diag(matrix(message.twist.covariance))
        assert 0 < forward < 1
        assert set(others) == {NOT_MEASURED}


def test_a_speed_that_nobody_said_is_stated_as_not_measured(tmp_path: Path) -> None:
    (message,) = said(bag_of(tmp_path, [replace(driven(0)[0], speed_mps=None)]), "/odom")
    assert set(np.diag(matrix(message.twist.covariance))) == {NOT_MEASURED}


def test_stated_odometry_is_never_exact_and_grows_unsure_with_the_way(bag: Path) -> None:
    stated = [matrix(message.pose.covariance) for message in said(bag, "/odom")]
    for covariance in stated:
        assert np.array_equal(covariance, covariance.T)
        assert np.linalg.eigvalsh(covariance).min() > 0
    assert all(np.diff([np.trace(covariance) for covariance in stated[1:]]) > 0)


@pytest.mark.parametrize("seed", range(20))
def test_the_simulator_s_odometry_errs_by_less_than_is_stated(tmp_path: Path, seed: int) -> None:
    last = said(bag_of(tmp_path, driven(seed)), "/odom")[-1]
    at, turn = last.pose.pose.position, last.pose.pose.orientation
    error = np.array([at.x - STEP_M * (FRAMES - 1), at.y, 2 * math.atan2(turn.z, turn.w)])
    plane = [0, 1, 5]
    covariance = matrix(last.pose.covariance)[np.ix_(plane, plane)]
    assert error @ np.linalg.solve(covariance, error) < 9


def test_each_frame_of_a_bag_has_a_place_in_base_link_and_that_in_odom(bag: Path) -> None:
    (mounting,) = said(bag, "/tf_static")
    assert {t.child_frame_id: t.header.frame_id for t in mounting.transforms} == dict.fromkeys(SENSORS, "base_link")
    assert {said(bag, topic)[0].header.frame_id for topic in ("/lidar/points", "/gnss/fix", "/imu/data")} == SENSORS
    placed = [transform for message in said(bag, "/tf") for transform in message.transforms]
    assert {(t.header.frame_id, t.child_frame_id) for t in placed} == {("odom", "base_link")}


def test_the_lidar_of_a_bag_is_where_it_was_mounted_and_the_receiver_at_the_origin(bag: Path) -> None:
    (mounting,) = said(bag, "/tf_static")
    places = {t.child_frame_id: matrix_of(t.transform) for t in mounting.transforms}
    assert places["lidar"] == pytest.approx(VEHICLE_FROM_SENSOR)
    assert places["gnss"] == pytest.approx(np.eye(4))
    assert places["imu"] == pytest.approx(np.eye(4))


def test_the_moving_transform_says_what_the_odometry_says(bag: Path) -> None:
    for message, wrote in zip(said(bag, "/tf"), driven(0), strict=True):
        (placed,) = message.transforms
        assert matrix_of(placed.transform) == pytest.approx(wrote.odom_from_vehicle)
        assert placed.header.stamp.sec + placed.header.stamp.nanosec / 1e9 == pytest.approx(wrote.stamp_s, abs=1e-6)


def test_whoever_subscribes_late_is_told_the_mounting_too(bag: Path) -> None:
    with Reader(bag) as reader:
        offered = {c.topic: [qos.durability for qos in c.ext.offered_qos_profiles] for c in reader.connections}
    assert offered.pop("/tf_static") == [QosDurability.TRANSIENT_LOCAL]
    assert not any(offered.values())


def test_a_bag_without_odometry_has_the_mounting_alone(tmp_path: Path) -> None:
    bag = bag_of(tmp_path, [replace(driven(0)[0], odom_from_vehicle=None)])
    assert len(said(bag, "/tf_static")) == 1
    assert said(bag, "/tf") == said(bag, "/odom") == []


def test_the_heading_and_the_odometry_of_a_bag_are_read_back(bag: Path) -> None:
    source = open_source(bag)
    assert not any(topic.startswith("/tf") for topic in source.topics.values())
    for read, wrote in zip(source, driven(0), strict=True):
        assert read.gnss is not None
        assert read.gnss.heading_rad == pytest.approx(1.25)
        assert read.odom_from_vehicle == pytest.approx(wrote.odom_from_vehicle)
        assert read.motions == ()
