from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from detector.pipeline import Method, detect
from detector.road.view import sees_road
from detector.types import DetectorInput
from tests.unit.detector.scenes import Block, Hole, Lidar, Street, cast

METHODS: tuple[Method, ...] = ("surface", "saliency")


def sweep_of(street: Street) -> DetectorInput:
    return DetectorInput(cast(street, Lidar(), 0.0, -1.5, 0)[0], 2.4)


@pytest.mark.parametrize("method", METHODS)
def test_a_sound_street_is_a_road_in_view_where_nothing_is_found(method: Method) -> None:
    detection = detect(sweep_of(Street()), method)
    assert (detection.road_seen, detection.obstacles) == (True, ())


def test_a_street_with_a_hole_and_parked_cars_is_a_road_in_view() -> None:
    cars = (Block(8.0, 2.9, 4.2, 1.6, 1.5), Block(15.0, -3.0, 4.2, 1.6, 1.5))
    assert detect(sweep_of(Street(holes=(Hole(10.0, 0.5, 0.9, 0.7, 0.12),), blocks=cars))).road_seen


def leaves(rng: np.random.Generator) -> np.ndarray:
    return np.column_stack([rng.uniform(-20, 20, (30_000, 2)), rng.uniform(-3.4, -1.4, 30_000)])


def wall(rng: np.random.Generator) -> np.ndarray:
    count = 20_000
    return np.column_stack([rng.normal(3.0, 0.02, count), rng.uniform(-6, 6, count), rng.uniform(-2.4, 3, count)])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("scene", [leaves, wall])
def test_leaves_and_a_wall_before_the_sensor_are_no_road(
    scene: Callable[[np.random.Generator], np.ndarray], method: Method
) -> None:
    points = scene(np.random.default_rng(4)).astype(np.float32)
    assert not detect(DetectorInput(points, 2.4), method).road_seen


def test_an_empty_sweep_and_one_of_a_sensor_upside_down_show_no_road() -> None:
    street = sweep_of(Street()).points_m
    for points in (street[:0], street * np.array([1.0, 1.0, -1.0], dtype=np.float32)):
        assert not detect(DetectorInput(points, 2.4)).road_seen


def test_a_road_behind_the_car_is_not_one_ahead() -> None:
    street = sweep_of(Street()).points_m
    assert not detect(DetectorInput(street[street[:, 0] < -2.0], 2.4)).road_seen


def test_a_survey_shows_a_road_unless_it_has_too_few_points() -> None:
    rng = np.random.default_rng(5)
    patch = np.column_stack([rng.uniform(0, 1, (5000, 2)), rng.normal(0, 0.001, 5000)]).astype(np.float32)
    assert detect(DetectorInput(patch, None)).road_seen
    assert not detect(DetectorInput(patch[:20], None)).road_seen


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.02))
def test_what_is_seen_does_not_hang_on_the_order_of_the_points(seed: int, noise_m: float) -> None:
    rng = np.random.default_rng(seed)
    along, across, residual = rng.uniform(-5, 12, 400), rng.uniform(-2, 2, 400), rng.normal(0, noise_m, 400)
    order = rng.permutation(400)
    assert sees_road(along, across, residual)
    assert sees_road(along[order], across[order], residual[order])
