"""Neighbours are the nearest ones, whatever the cloud."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from detector.errors import DetectorError
from detector.neighbours.nearest import find_neighbourhoods

RNG_SEED = 11


def lidar_like(seed: int, count: int = 12_000) -> np.ndarray:
    """Rings whose spacing grows with range, and a wall: the density varies by orders of magnitude."""
    rng = np.random.default_rng(seed)
    azimuth, elevation = rng.uniform(-np.pi, np.pi, count), -np.radians(rng.integers(2, 26, count))
    range_m = np.minimum(1.73 / np.sin(-elevation), 30.0) + rng.normal(0, 0.02, count)
    flat = range_m * np.cos(elevation)
    return np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), range_m * np.sin(elevation)])


def clouds() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(RNG_SEED)
    axis = np.arange(40.0)
    return {
        "a lidar's": lidar_like(1),
        "of a solid": rng.normal(size=(3000, 3)),
        "on a grid, with many equal distances": np.stack(np.meshgrid(axis, axis, [0.0]), axis=-1).reshape(-1, 3),
        "on a line": np.column_stack([np.arange(900.0), np.zeros((900, 2))]),
        "with an outlier far away": np.vstack([rng.normal(size=(2000, 3)), [[1e6, 0.0, 0.0]]]),
        "with most points in one place": np.vstack([np.zeros((900, 3)), rng.normal(size=(500, 3))]),
        "of points that all coincide": np.full((900, 3), 7.0),
        "of as many points as are asked for": rng.normal(size=(31, 3)),
    }


@pytest.mark.parametrize("name", list(clouds()))
def test_the_neighbours_are_as_near_as_an_exhaustive_search_finds_them(name: str) -> None:
    points = clouds()[name]
    found = find_neighbourhoods(points, 31)
    cloud = points[found.order]
    expected, _ = cKDTree(cloud).query(cloud, k=31)
    distances = np.sort(np.linalg.norm(cloud[found.nearest] - cloud[:, None], axis=2), axis=1)
    resolution = 4.0 * np.finfo(np.float32).eps * np.ptp(points, axis=0).max()
    assert distances == pytest.approx(expected, rel=1e-4, abs=max(resolution, 1e-9))


@pytest.mark.parametrize("name", list(clouds()))
def test_no_neighbour_is_counted_twice_and_every_point_has_its_row(name: str) -> None:
    points = clouds()[name]
    found = find_neighbourhoods(points, 31)
    assert np.array_equal(np.sort(found.order), np.arange(len(points)))
    in_order = np.sort(found.nearest, axis=1)
    assert (in_order[:, 1:] > in_order[:, :-1]).all()


def test_a_point_is_among_its_own_neighbours() -> None:
    found = find_neighbourhoods(lidar_like(2), 9)
    assert (found.nearest == np.arange(len(found.order))[:, None]).any(axis=1).all()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31), st.integers(9, 400), st.integers(1, 9), st.floats(1e-3, 1e4), st.floats(-1e4, 1e4))
def test_the_neighbours_do_not_depend_on_unit_or_origin(
    seed: int, points: int, count: int, unit: float, shift: float
) -> None:
    cloud = np.random.default_rng(seed).uniform(-1, 1, (points, 3))
    found = find_neighbourhoods(cloud * unit + shift * unit, count)
    moved = cloud[found.order]
    expected, _ = cKDTree(moved).query(moved, k=count)
    farthest = np.linalg.norm(moved[found.nearest] - moved[:, None], axis=2).max(axis=1)
    assert farthest == pytest.approx(np.reshape(expected, (points, count))[:, -1], rel=1e-3, abs=1e-5)


def test_the_same_cloud_gives_the_same_bytes_whatever_the_threads_do() -> None:
    cloud = lidar_like(3, 20_000)
    once = find_neighbourhoods(cloud, 31)
    for _ in range(3):
        again = find_neighbourhoods(cloud, 31)
        assert again.nearest.tobytes() == once.nearest.tobytes()
        assert again.order.tobytes() == once.order.tobytes()


def test_too_few_points_and_points_that_are_nowhere_are_refused() -> None:
    with pytest.raises(DetectorError, match="5 points"):
        find_neighbourhoods(np.zeros((5, 3)), 6)
    with pytest.raises(DetectorError, match="finite"):
        find_neighbourhoods(np.array([[0.0, np.nan, 0.0]] * 9), 3)
