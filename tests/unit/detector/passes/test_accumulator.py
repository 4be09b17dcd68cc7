"""Sweeps put together in `odom`, with bounded memory."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detector.errors import DetectorError
from detector.passes.accumulator import MAX_KEYFRAMES, Accumulator, accumulate, hits_around
from detector.types import DetectorInput, FrameDetection
from tests.unit.detector.sweeps_of_a_pass import detection_without_residual


def pose_at(x: float, y: float = 0.0, yaw: float = 0.0) -> np.ndarray:
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    pose[:3, 3] = x, y, 2.4
    return pose


def step(state: Accumulator, points: np.ndarray, pose: np.ndarray, residual: np.ndarray | None = None) -> Accumulator:
    detection = detection_without_residual(len(points))
    if residual is not None:
        detection = FrameDetection(detection.labels, detection.saliency, residual.astype(np.float32), ())
    return accumulate(state, DetectorInput(points.astype(np.float32), 2.4, odom_from_sensor=pose), detection)


@settings(max_examples=30, deadline=None)
@given(st.floats(-1e5, 1e5), st.floats(-1e5, 1e5), st.floats(-np.pi, np.pi))
def test_a_hit_is_found_at_its_place_in_odom_to_a_millimetre_however_far_the_drive(
    x: float, y: float, yaw: float
) -> None:
    pose = pose_at(x, y, yaw)
    point = np.array([[6.0, 1.0, -2.4]])
    place = pose[:3, :3] @ point[0] + pose[:3, 3]
    hits = hits_around(step(Accumulator(), point, pose), place[:2])
    assert hits.points_m == pytest.approx(place[None], abs=1e-3)
    assert hits.origins_m == pytest.approx(pose[None, :3, 3])


def test_standing_still_adds_nothing() -> None:
    point = np.array([[6.0, 0.0, -2.4]])
    state = step(Accumulator(), point, pose_at(0.0))
    assert step(state, point, pose_at(0.2)) is state
    assert len(step(state, point, pose_at(0.4)).keyframes) == 2


def test_frames_farther_than_thirty_metres_behind_are_forgotten() -> None:
    state = Accumulator()
    for x in np.arange(0.0, 100.0, 1.0):
        state = step(state, np.array([[6.0, 0.0, -2.4]]), pose_at(float(x)))
    assert min(k.origin_odom_m[0] for k in state.keyframes) >= 69.0
    assert len(state.keyframes) <= 31


def test_memory_is_bounded_even_for_a_car_that_drives_in_circles() -> None:
    state = Accumulator()
    for angle in np.linspace(0, 60 * np.pi, 3000):
        pose = pose_at(5 * float(np.cos(angle)), 5 * float(np.sin(angle)), float(angle) + np.pi / 2)
        state = step(state, np.array([[6.0, 0.0, -2.4]]), pose)
    assert len(state.keyframes) == MAX_KEYFRAMES


def test_only_hits_near_the_road_and_near_the_car_are_kept() -> None:
    points = np.array([[6.0, 0.0, -2.4], [6.0, 0.1, -1.4], [6.0, 0.2, -2.4], [13.0, 0.0, -2.4], [np.nan, 0.0, 0.0]])
    residual = np.array([0.0, 1.0, np.nan, 0.0, np.nan])
    state = step(Accumulator(), points, pose_at(0.0), residual)
    assert len(state.keyframes[0].offsets_m) == 1


def test_frames_without_hits_at_the_place_are_not_counted() -> None:
    state = step(Accumulator(), np.array([[6.0, 0.0, -2.4]]), pose_at(0.0))
    state = step(state, np.array([[6.0, 5.0, -2.4]]), pose_at(1.0))
    state = step(state, np.array([[4.0, 0.0, -2.4]]), pose_at(2.0))
    hits = hits_around(state, np.array([6.0, 0.0]))
    assert hits.frames == 2
    assert hits.frame.tolist() == [0, 1]
    assert hits.origins_m[:, 0].tolist() == [0.0, 2.0]


def test_a_place_never_seen_has_no_hits() -> None:
    hits = hits_around(Accumulator(), np.array([1.0, 2.0]))
    assert hits.points_m.shape == (0, 3)
    assert hits.frames == 0


@pytest.mark.parametrize("pose", [None, np.eye(3), np.full((4, 4), np.nan)])
def test_sweeps_without_a_usable_pose_are_refused(pose: np.ndarray | None) -> None:
    sweep = DetectorInput(np.zeros((1, 3), dtype=np.float32), 2.4, odom_from_sensor=pose)
    with pytest.raises(DetectorError, match="odom_from_sensor"):
        accumulate(Accumulator(), sweep, detection_without_residual(1))
