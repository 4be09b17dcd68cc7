"""The corridor follows the road's kerbs where the steering's circle leaves it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detector.pipeline import detect
from detector.road.corridor import find_corridor
from detector.road.ground import from_road_coordinates, near_ground, road_coordinates
from detector.types import DetectorInput, PointClass

SENSOR_HEIGHT_M = 1.73
KERB_M = 0.12


def road(curvature_per_m: float, change_per_m2: float = 0.0, left_m: float = 4.5, right_m: float = -1.7) -> np.ndarray:
    """Points of a road between kerbs whose curvature grows with distance, in the frame `sensor`."""
    rng = np.random.default_rng(1)
    s, t = rng.uniform(-15.0, 32.0, 60_000), rng.uniform(-9.0, 9.0, 60_000)
    heading = curvature_per_m * s + change_per_m2 * s * s / 2.0
    x = s - heading**2 * s / 6.0 - t * np.sin(heading)
    y = curvature_per_m * s**2 / 2.0 + change_per_m2 * s**3 / 6.0 + t * np.cos(heading)
    z = np.where((t < left_m) & (t > right_m), 0.0, KERB_M) + rng.normal(0.0, 0.005, s.size) - SENSOR_HEIGHT_M
    return np.stack([x, y, z], axis=1)


@settings(deadline=None)
@given(
    along=st.floats(-20.0, 40.0), across=st.floats(-8.0, 8.0), curvature=st.floats(-0.03, 0.03).filter(lambda c: c != 0)
)
def test_road_coordinates_and_their_inverse_agree(along: float, across: float, curvature: float) -> None:
    xy = from_road_coordinates(np.array([along]), np.array([across]), curvature)
    back = road_coordinates(np.concatenate([xy, np.zeros((1, 1))], axis=1), curvature)
    assert np.allclose(np.concatenate(back), [along, across], atol=1e-6)


@settings(max_examples=8, deadline=None)
@given(curvature=st.floats(-0.02, 0.02))
def test_kerbs_are_found_along_a_steady_curve(curvature: float) -> None:
    corridor = find_corridor(near_ground(road(curvature), SENSOR_HEIGHT_M, curvature), curvature)
    assert corridor.left_m == pytest.approx(4.5, abs=0.35)
    assert corridor.right_m == pytest.approx(-1.7, abs=0.35)


@pytest.mark.parametrize("change", [-8e-4, 8e-4])
def test_the_path_bends_with_a_curve_that_begins_ahead(change: float) -> None:
    corridor = find_corridor(near_ground(road(0.0, change), SENSOR_HEIGHT_M, 0.0), 0.0)
    ahead = np.array([25.0])
    assert corridor.offset_m(ahead)[0] == pytest.approx(change * 25.0**3 / 6.0, abs=0.5)


def test_a_road_without_kerbs_has_the_default_width() -> None:
    flat = road(0.0, left_m=20.0, right_m=-20.0)
    corridor = find_corridor(near_ground(flat, SENSOR_HEIGHT_M, 0.0), 0.0)
    assert (corridor.left_m, corridor.right_m) == (3.5, -3.5)


def road_share(labels: np.ndarray, on_road: np.ndarray) -> float:
    """Intersection over union of what is called road and what is."""
    called = np.isin(labels, [PointClass.SAFE_ROAD, PointClass.NEGATIVE, PointClass.POSITIVE])
    return float((called & on_road).sum() / (called | on_road).sum())


def test_on_a_curve_of_thirty_metres_the_true_steering_finds_more_of_the_road_than_none() -> None:
    rng = np.random.default_rng(2)
    s, t = rng.uniform(3.0, 30.0, 60_000), rng.uniform(-7.0, 9.0, 60_000)
    on_road = (t < 4.5) & (t > -1.7)
    z = np.where(on_road, 0.0, KERB_M) + rng.normal(0.0, 0.005, s.size) - SENSOR_HEIGHT_M
    points = np.concatenate([from_road_coordinates(s, t, 1 / 30), z[:, None]], axis=1).astype(np.float32)
    steered = road_share(detect(DetectorInput(points, SENSOR_HEIGHT_M, 1 / 30)).labels, on_road)
    straight = road_share(detect(DetectorInput(points, SENSOR_HEIGHT_M, 0.0)).labels, on_road)
    assert steered > 0.9
    assert steered > straight + 0.05


@pytest.mark.parametrize("grade", [-0.08, 0.08])
def test_a_road_on_a_slope_that_is_first_seen_ahead_is_road(grade: float) -> None:
    rng = np.random.default_rng(4)
    s, t = rng.uniform(4.0, 30.0, 40_000), rng.uniform(-3.0, 3.0, 40_000)
    z = grade * s - SENSOR_HEIGHT_M + rng.normal(0.0, 0.005, s.size)
    labels = detect(DetectorInput(np.stack([s, t, z], axis=1).astype(np.float32), SENSOR_HEIGHT_M)).labels
    assert (labels == PointClass.SAFE_ROAD).mean() > 0.99
