"""What a ring of a real sensor does wrong, and what stands beside the road, is no obstacle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import label

from detector.obstacles.clusters import OCCUPIED, Cluster, group, number_components
from detector.obstacles.verification import find_clusters
from detector.road.corridor import Corridor
from detector.road.deviations import Deviations

CORRIDOR = Corridor(0.0, 3.5, -3.5)
SENSOR_HEIGHT_M = 2.4
NOISE_M = 0.01


def flat_road(rings: int = 64) -> Deviations:
    """A flat road seen ahead by rings of even elevation, 0.4 degrees between columns, hits 2 mm off the surface."""
    range_m = SENSOR_HEIGHT_M / np.tan(np.deg2rad(np.linspace(30.0, 5.0, rings)))
    azimuth = np.deg2rad(np.arange(-60.0, 60.0, 0.4))
    r, a = (v.ravel() for v in np.meshgrid(range_m, azimuth, indexing="ij"))
    keep = np.abs(r * np.sin(a)) < 3.7
    r, a = r[keep], a[keep]
    residual = np.random.default_rng(1).normal(0.0, 0.002, r.size)
    r = r * (SENSOR_HEIGHT_M - residual) / SENSOR_HEIGHT_M
    return Deviations(r * np.cos(a), r * np.sin(a), r, residual, np.full(r.size, NOISE_M), SENSOR_HEIGHT_M)


def azimuth_rad(road: Deviations) -> np.ndarray:
    return np.arctan2(road.across_m, road.along_m)


def level_range_m(road: Deviations) -> np.ndarray:
    """Where each ray crosses the road's level: one value a ring, in a hole or beside it."""
    return road.range_m * SENSOR_HEIGHT_M / (SENSOR_HEIGHT_M - road.residual_m)


def with_residual(road: Deviations, where: np.ndarray, residual_m: float) -> Deviations:
    """The same rays, meeting their hits `residual_m` over the road's level: nearer by as much as that takes."""
    nearer = np.where(where, (SENSOR_HEIGHT_M - residual_m) / (SENSOR_HEIGHT_M - road.residual_m), 1.0)
    return replace(
        road,
        along_m=road.along_m * nearer,
        across_m=road.across_m * nearer,
        range_m=road.range_m * nearer,
        residual_m=np.where(where, residual_m, road.residual_m),
    )


def without(road: Deviations, hidden: np.ndarray) -> Deviations:
    columns = ("along_m", "across_m", "range_m", "residual_m", "noise_m")
    return replace(road, **{name: getattr(road, name)[~hidden] for name in columns})


def ring_near(road: Deviations, range_m: float) -> np.ndarray:
    level = level_range_m(road)
    return np.asarray(np.isclose(level, level[np.argmin(np.abs(level - range_m))]))


def clusters_of(road: Deviations) -> list[Cluster]:
    return find_clusters(road, CORRIDOR.contains(road.along_m, road.across_m), CORRIDOR).clusters


def hole_at(road: Deviations, range_m: float, length_m: float = 0.9, width_m: float = 0.7) -> np.ndarray:
    return np.asarray(np.hypot((road.along_m - range_m) / length_m, road.across_m / width_m) < 0.5)


def test_a_hole_with_road_on_all_sides_is_one_cluster() -> None:
    road = flat_road()
    (cluster,) = clusters_of(with_residual(road, hole_at(road, 8.0), -0.08))
    assert cluster.is_negative


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_low_place_at_the_edge_of_a_shadow_is_no_hole(side: float) -> None:
    road = flat_road()
    seen = with_residual(road, hole_at(road, 8.0), -0.08)
    shadow = (side * azimuth_rad(road) > 0.02) & (side * azimuth_rad(road) < 0.25)
    assert clusters_of(without(seen, shadow)) == []


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_ring_that_lies_wrong_everywhere_is_neither_hole_nor_rise_where_it_passes_the_threshold(sign: float) -> None:
    road = flat_road()
    ring = ring_near(road, 12.0)
    lowest = ring & (np.abs(road.across_m) < 0.4)
    assert clusters_of(with_residual(with_residual(road, ring, sign * 0.025), lowest, sign * 0.045)) == []
    (alone,) = clusters_of(with_residual(road, lowest, sign * 0.045))
    assert alone.is_negative == (sign < 0.0)


@pytest.mark.parametrize("residual_m", [-0.05, 0.05])
def test_a_stripe_along_one_of_many_close_rings_is_that_rings_calibration(residual_m: float) -> None:
    road = flat_road()
    stripe = ring_near(road, 6.0) & (np.abs(road.across_m) < 1.15)
    assert clusters_of(with_residual(road, stripe, residual_m)) == []


def test_a_short_hump_as_wide_as_the_lane_is_no_stripe() -> None:
    road = flat_road(rings=192)
    hump = (np.abs(road.along_m - 5.0) < 0.2) & (road.across_m < 1.0) & (road.across_m > -2.3)
    (cluster,) = clusters_of(with_residual(road, hump, 0.06))
    assert not cluster.is_negative


def test_a_hump_that_leaves_no_road_beside_it_is_found() -> None:
    road = flat_road()
    (cluster,) = clusters_of(with_residual(road, np.abs(road.along_m - 8.0) < 0.4, 0.09))
    assert not cluster.is_negative


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.02, 0.5))
def test_cells_that_touch_are_one_component_in_the_order_of_the_rows(seed: int, share: float) -> None:
    occupied = np.random.default_rng(seed).random((23, 31)) < share
    component = np.where(occupied, OCCUPIED, 0).astype(np.int32)
    number_components(component)
    expected, _ = label(occupied, structure=np.ones((3, 3)))
    assert np.array_equal(component, expected)


def test_what_lies_a_cell_apart_is_two_clusters_and_a_point_alone_is_none() -> None:
    along = np.array([5.0, 5.1, 6.5, 6.6, 20.0, 5.05])
    across, height_m = np.zeros(6), 1.7
    road = Deviations(along, across, along, np.full(6, -0.1), np.full(6, NOISE_M), height_m)
    candidates = np.array([True, True, True, True, True, False])
    assert [members.tolist() for members in group(road, candidates)] == [[0, 1], [2, 3]]
    assert group(road, np.zeros(6, dtype=np.bool_)) == []
