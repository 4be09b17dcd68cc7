"""What the LiDAR evaluation counts, and what it carves."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.carving import carve
from evaluation.fit_confidence import logistic_weights
from evaluation.lidar import calibration_error
from evaluation.segmentation import Confusion
from simulator.shapes.pothole import pothole

SENSOR_HEIGHT_M = 1.73


def flat_scan() -> np.ndarray:
    elevation, azimuth = np.meshgrid(np.radians(np.linspace(-25.0, -2.0, 64)), np.radians(np.arange(-30.0, 30.0, 0.17)))
    range_m = SENSOR_HEIGHT_M / np.tan(-elevation)
    x, y = range_m * np.cos(azimuth), range_m * np.sin(azimuth)
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, -SENSOR_HEIGHT_M)], axis=1).astype(np.float32)


def test_a_carved_ray_goes_on_along_its_line_to_the_holes_floor() -> None:
    scan = flat_scan()
    carved = carve(scan, pothole(1, 0.9, 0.7, 0.15), np.array([8.0, 0.0]), 0.3)
    assert carved is not None
    moved = (carved.points_m != scan).any(axis=1)
    assert moved.sum() > 10
    before, after = scan[moved].astype(float), carved.points_m[moved].astype(float)
    along = np.einsum("ij,ij->i", before, after) / np.linalg.norm(before, axis=1) / np.linalg.norm(after, axis=1)
    assert along == pytest.approx(1.0, abs=1e-6)
    assert (after[:, 2] <= -SENSOR_HEIGHT_M + 1e-3).all()
    assert after[:, 2].min() > -SENSOR_HEIGHT_M - 0.17
    assert np.hypot(before[:, 0] - 8.0, before[:, 1]).max() < 0.75


@pytest.mark.parametrize(("depth_m", "is_shown"), [(0.15, True), (0.018, False)])
def test_a_hole_is_shown_where_enough_rays_end_deep_in_it(depth_m: float, is_shown: bool) -> None:
    scan = flat_scan()
    carved = carve(scan, pothole(1, 0.9, 0.7, depth_m), np.array([8.0, 0.0]), 0.0)
    assert carved is not None
    assert carved.is_shown is is_shown
    assert carved.deep_hits == (carved.points_m[:, 2] < -SENSOR_HEIGHT_M - 0.02).sum()


def test_nothing_is_carved_where_something_stands() -> None:
    scan = flat_scan()
    blocked = (np.abs(scan[:, 0] - 8.3) < 0.3) & (np.abs(scan[:, 1]) < 0.5)
    scan[blocked, 2] += 0.5
    assert carve(scan, pothole(1, 0.9, 0.7, 0.15), np.array([8.0, 0.0]), 0.0) is None


def test_the_calibration_error_of_a_forecast_is_its_distance_from_the_truth() -> None:
    pairs = np.array([[0.75, 1.0]] * 3 + [[0.75, 0.0]])
    assert calibration_error(pairs) == pytest.approx(0.0)
    assert calibration_error(np.array([[0.95, 0.0]] * 5)) == pytest.approx(0.95)


def test_the_regression_finds_the_weights_that_made_the_data() -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(0.0, 1.0, (20_000, 2)) * np.array([1.0, 5.0])
    truth = rng.random(20_000) < 1.0 / (1.0 + np.exp(-(0.5 + 2.0 * values[:, 0] - 0.3 * values[:, 1])))
    assert logistic_weights(values, truth) == pytest.approx([0.5, 2.0, -0.3], abs=0.1)


def test_intersection_over_union_counts_both_kinds_of_errors() -> None:
    counts = np.zeros((4, 4), dtype=np.int64)
    counts[1, 1], counts[1, 0], counts[0, 1] = 80, 10, 10
    shares = Confusion(counts).intersection_over_union()
    assert shares["road"] == pytest.approx(0.8)
