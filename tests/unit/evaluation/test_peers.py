"""The peers answer as they are meant to, on clouds whose truth is plain."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.peers import PATCH_PEERS, SWEEP_PEERS, point_spacing

SENSOR_HEIGHT_M = 1.73


def patch_with_hole(unit: float) -> tuple[np.ndarray, np.ndarray]:
    """A flat patch of 0.5 m with a round hole 30 mm deep, and the mask of the hole."""
    axis = np.arange(-0.2, 0.2, 0.006)
    x, y = (a.ravel() for a in np.meshgrid(axis, axis))
    x, y = x + np.random.default_rng(1).uniform(-5e-4, 5e-4, x.size), y
    in_hole = np.hypot(x, y) < 0.08
    return np.column_stack([x, y, np.where(in_hole, -0.03, 0.0)]) * unit, in_hole


def sweep_with_box() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Road, walls to both sides and a box on the road 9 m ahead; the masks of the road's strip and of the box."""
    rng = np.random.default_rng(2)
    x, y = rng.uniform(-15, 25, 30_000), rng.uniform(-8, 8, 30_000)
    on_box = (np.abs(x - 9.0) < 0.4) & (np.abs(y) < 0.4)
    z = np.where(on_box, 0.3, 0.0)
    wall = np.column_stack([rng.uniform(-15, 25, 3000), rng.choice([-8.0, 8.0], 3000), rng.uniform(0, 3, 3000)])
    points = np.vstack([np.column_stack([x, y, z]), wall]) - (0, 0, SENSOR_HEIGHT_M)
    points += rng.normal(0, 0.005, points.shape)
    return points, np.abs(points[:, 1]) < 3.0, np.concatenate([on_box, np.zeros(3000, dtype=bool)])


@pytest.mark.parametrize("name", PATCH_PEERS)
@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_a_peer_finds_a_deep_hole_in_a_flat_patch_in_any_unit(name: str, unit: float) -> None:
    points, in_hole = patch_with_hole(unit)
    called = PATCH_PEERS[name](points)
    assert called.shape == in_hole.shape
    assert called[in_hole].mean() > 0.9
    assert called[~in_hole].mean() < 0.2


@pytest.mark.parametrize("name", SWEEP_PEERS)
def test_a_peer_says_the_same_twice(name: str) -> None:
    points, on_road, _ = sweep_with_box()
    once, again = (SWEEP_PEERS[name](points, SENSOR_HEIGHT_M, on_road) for _ in range(2))
    assert len(once) == len(again)
    assert all(np.array_equal(a, b) for a, b in zip(once, again, strict=True))


@pytest.mark.parametrize("name", PATCH_PEERS)
@pytest.mark.parametrize("count", [0, 1, 29])
def test_a_peer_calls_nothing_an_obstacle_where_there_is_next_to_nothing(name: str, count: int) -> None:
    assert not PATCH_PEERS[name](np.zeros((count, 3))).any()


@pytest.mark.parametrize("name", SWEEP_PEERS)
def test_a_peer_finds_the_box_on_the_road_and_no_wall(name: str) -> None:
    points, on_road, on_box = sweep_with_box()
    clusters = SWEEP_PEERS[name](points, SENSOR_HEIGHT_M, on_road)
    assert max(on_box[cluster].sum() for cluster in clusters) > 0.5 * on_box.sum()
    assert all(on_road[cluster].all() for cluster in clusters)


@pytest.mark.parametrize("name", SWEEP_PEERS)
def test_a_peer_finds_nothing_where_no_road_is_in_view(name: str) -> None:
    points, on_road, _ = sweep_with_box()
    assert SWEEP_PEERS[name](points, SENSOR_HEIGHT_M, np.zeros_like(on_road)) == []


def test_a_peers_chatter_stays_out_of_the_printed_tables(capfd: pytest.CaptureFixture[str]) -> None:
    points, on_road, _ = sweep_with_box()
    for peer in SWEEP_PEERS.values():
        peer(points[::50], SENSOR_HEIGHT_M, on_road[::50])
    assert capfd.readouterr().out == ""


def test_spacing_is_the_distance_to_the_nearest_other_point() -> None:
    axis = np.arange(20.0) * 0.3
    grid = np.stack(np.meshgrid(axis, axis, [0.0]), axis=-1).reshape(-1, 3)
    assert point_spacing(grid) == pytest.approx(0.3)
