"""What one sweep says of its own rings: their errors go, obstacles and humps stay."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detector.road.sweep_rings import sweep_ring_offsets

HEIGHT_M = 1.73
ELEVATION_DEG = np.arange(-24.0, -5.0, 0.5)
NOISE_M = 0.002


def rings_of_a_road(seed: int, bias_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (N, 3) of a flat road before and behind, their ring, and their residual: a bias a ring, and noise.

    No bias is beyond three standard deviations: a ring that is off by more than `MAX_OFFSET_M` counts as a hump.
    """
    rng = np.random.default_rng(seed)
    azimuth = np.radians(np.arange(0.0, 360.0, 0.3))
    ring, a = (v.ravel() for v in np.meshgrid(np.arange(ELEVATION_DEG.size), azimuth, indexing="ij"))
    range_m = HEIGHT_M / np.tan(-np.radians(ELEVATION_DEG[ring]))
    points = np.stack([range_m * np.cos(a), range_m * np.sin(a), np.full(a.size, -HEIGHT_M)], axis=1)
    on_strip = np.abs(points[:, 1]) < 3.5
    biases_m = np.clip(rng.normal(0.0, bias_m, ELEVATION_DEG.size), -3 * bias_m, 3 * bias_m)
    residual = biases_m[ring] + rng.normal(0.0, NOISE_M, a.size)
    return points[on_strip], ring[on_strip], residual[on_strip]


def offsets_of(points: np.ndarray, residual: np.ndarray) -> np.ndarray:
    return sweep_ring_offsets(points, np.arange(len(points)), points[:, 0], points[:, 1], residual)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_the_errors_of_rings_are_taken_out(seed: int) -> None:
    points, ring, residual = rings_of_a_road(seed, 0.008)
    left = residual - offsets_of(points, residual)
    means = [left[ring == r].mean() for r in np.unique(ring)]
    assert np.abs(means).max() < 0.002


def test_a_hole_keeps_its_depth() -> None:
    points, _, residual = rings_of_a_road(1, 0.008)
    hole = np.hypot(points[:, 0] - 8.0, points[:, 1]) < 0.4
    before = offsets_of(points, residual)
    assert offsets_of(points, residual - 0.05 * hole) == pytest.approx(before, abs=0.001)


def test_a_low_hump_across_the_road_ahead_is_no_error_of_its_rings() -> None:
    points, _, residual = rings_of_a_road(2, 0.0)
    hump = np.abs(points[:, 0] - 8.0) < 0.5
    assert np.abs(offsets_of(points, residual + 0.025 * hump)[hump]).max() < 0.003


def test_where_rings_cannot_be_told_apart_nothing_is_taken_out() -> None:
    points, _, residual = rings_of_a_road(3, 0.008)
    tilt = np.radians(3.0)
    turn = np.array([[np.cos(tilt), 0.0, np.sin(tilt)], [0.0, 1.0, 0.0], [-np.sin(tilt), 0.0, np.cos(tilt)]])
    jitter = np.random.default_rng(4).uniform(-0.3, 0.3, (len(points), 3)) * [0.0, 0.0, 1.0]
    assert (offsets_of(points @ turn.T + jitter, residual) == 0.0).all()


def test_no_points_have_no_offsets() -> None:
    assert offsets_of(np.empty((0, 3)), np.empty(0)).size == 0
