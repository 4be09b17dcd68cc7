from __future__ import annotations

import math

import carla
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from simulator.mesh import pose
from simulator.recording.handedness import (
    MIRROR,
    CarlaTransform,
    carla_transform,
    mirrored_points,
    right_handed_transform,
)

metres = st.floats(-1e4, 1e4)
any_pose = st.builds(
    CarlaTransform, metres, metres, metres, st.floats(-89.9, 89.9), st.floats(-179.9, 179.9), st.floats(-179.9, 179.9)
)


@given(any_pose)
def test_a_pose_survives_the_way_to_our_hand_and_back(given_pose: CarlaTransform) -> None:
    back = carla_transform(right_handed_transform(given_pose))
    for name in ("x", "y", "z", "pitch", "yaw", "roll"):
        assert getattr(back, name) == pytest.approx(getattr(given_pose, name), abs=1e-6)


@given(any_pose)
def test_our_matrix_is_carlas_own_with_y_turned_round(given_pose: CarlaTransform) -> None:
    theirs = carla.Transform(
        carla.Location(given_pose.x, given_pose.y, given_pose.z),
        carla.Rotation(pitch=given_pose.pitch, yaw=given_pose.yaw, roll=given_pose.roll),
    ).get_matrix()
    # CARLA computes in float32.
    assert MIRROR @ right_handed_transform(given_pose) @ MIRROR == pytest.approx(np.array(theirs), rel=1e-6, abs=1e-5)


@given(any_pose)
def test_the_result_is_a_right_handed_rigid_transform(given_pose: CarlaTransform) -> None:
    rotation = right_handed_transform(given_pose)[:3, :3]
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@given(st.floats(-math.pi, math.pi), st.sampled_from([-1, 1]))
def test_looking_straight_up_or_down_the_rotation_survives(yaw_rad: float, sign: int) -> None:
    straight = pose(1, 2, 3, yaw_rad, sign * math.pi / 2, 0.0)
    assert right_handed_transform(carla_transform(straight)) == pytest.approx(straight, abs=1e-9)


@given(st.integers(0, 2**32 - 1))
def test_every_rotation_survives(seed: int) -> None:
    transform = np.eye(4)
    transform[:3, :3] = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    assert right_handed_transform(carla_transform(transform)) == pytest.approx(transform, abs=1e-9)


def test_a_left_turn_uphill_is_a_negative_yaw_and_a_raised_nose_in_carla() -> None:
    # In our frames a positive pitch lowers the nose (rotation about y, which points left).
    there = carla_transform(pose(110.9, 100.4, 2.4, math.radians(90), math.radians(-5), math.radians(3)))
    assert (there.x, there.y, there.z) == (110.9, -100.4, 2.4)
    assert (there.pitch, there.yaw, there.roll) == pytest.approx((5.0, -90.0, 3.0))


def test_a_lean_to_the_right_is_a_positive_roll_for_both() -> None:
    # y (left) of the body points up: the right side is lower.
    leaning = pose(0, 0, 0, 0.0, 0.0, math.radians(10))
    assert leaning[2, 1] > 0
    assert carla_transform(leaning).roll == pytest.approx(10.0)


def test_the_text_is_carlas() -> None:
    text = str(CarlaTransform(110.5, -100.25, 2.5, 1.0, 90.0, -3.0))
    assert text == str(carla.Transform(carla.Location(110.5, -100.25, 2.5), carla.Rotation(1, 90, -3)))


def test_points_are_mirrored_and_back() -> None:
    points = np.random.default_rng(0).normal(0, 10, (50, 3)).astype(np.float32)
    assert mirrored_points(points)[:, 1].tolist() == (-points[:, 1]).tolist()
    assert mirrored_points(mirrored_points(points)).tolist() == points.tolist()
