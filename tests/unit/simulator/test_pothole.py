from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.debris import broken_pallet
from simulator.pothole import GRID_STEP_M, bump, pothole

SEEDS = st.integers(0, 10_000)


@settings(max_examples=25, deadline=None)
@given(SEEDS, st.floats(0.35, 1.5), st.floats(0.3, 1.0), st.floats(0.04, 0.2))
def test_a_pothole_has_the_size_that_was_asked_for(seed: int, length: float, width: float, depth: float) -> None:
    hole = pothole(seed, length, width, depth)
    assert hole.length_m == pytest.approx(length, abs=3 * GRID_STEP_M)
    assert hole.width_m == pytest.approx(width, abs=3 * GRID_STEP_M)
    assert hole.relief_m == pytest.approx(depth)
    assert 0.6 < hole.footprint_area_m2 / (length * width) < 1.0
    assert (hole.heights_m[hole.footprint] <= 0).all()


@settings(max_examples=25, deadline=None)
@given(SEEDS)
def test_the_border_of_a_relief_meets_the_road(seed: int) -> None:
    for relief in (pothole(seed, 0.9, 0.7, 0.12), bump(seed, 0.9, 0.6, 0.09)):
        edges = (relief.heights_m[0], relief.heights_m[-1], relief.heights_m[:, 0], relief.heights_m[:, -1])
        assert max(np.abs(edge).max() for edge in edges) < 0.001


def test_the_rim_of_a_pothole_stands_up_a_little_and_no_more() -> None:
    hole = pothole(4, 0.9, 0.7, 0.12)
    rim = hole.heights_m[~hole.footprint]
    assert 0.003 < rim.max() < 0.02
    assert rim.min() > -0.02


def test_a_bump_only_rises() -> None:
    rise = bump(1, 0.9, 0.6, 0.09)
    assert rise.heights_m.min() == 0
    assert rise.relief_m == pytest.approx(0.09)


@settings(max_examples=25, deadline=None)
@given(SEEDS, st.floats(0.5, 2.0))
def test_growth_multiplies_the_area_and_keeps_the_depth(seed: int, factor: float) -> None:
    for shape in (pothole(seed, 0.9, 0.7, 0.12), bump(seed, 0.6, 0.5, 0.08), broken_pallet(seed, 0.8, 0.6, 0.3)):
        grown = shape.grown(factor)
        assert grown.footprint_area_m2 == pytest.approx(factor * shape.footprint_area_m2)
        assert grown.length_m * grown.width_m == pytest.approx(factor * shape.length_m * shape.width_m)
        assert grown.relief_m == pytest.approx(shape.relief_m)


def test_the_same_seed_gives_the_same_hole_and_another_seed_another() -> None:
    one, again, other = pothole(5, 0.9, 0.7, 0.12), pothole(5, 0.9, 0.7, 0.12), pothole(6, 0.9, 0.7, 0.12)
    assert one.heights_m.tobytes() == again.heights_m.tobytes()
    assert one.heights_m.tobytes() != other.heights_m.tobytes()


def test_heights_between_grid_points_lie_between_their_neighbours() -> None:
    hole = pothole(7, 0.9, 0.7, 0.12)
    rows, columns = hole.heights_m.shape
    x = (np.arange(columns - 1) + 0.5 - (columns - 1) / 2) * hole.step_m
    middle = hole.height_at(x, np.zeros_like(x))
    row = hole.heights_m[(rows - 1) // 2]
    assert (middle <= np.maximum(row[:-1], row[1:]) + 1e-12).all()
    assert (middle >= np.minimum(row[:-1], row[1:]) - 1e-12).all()


def test_a_pallet_stands_on_the_road_and_fills_its_box() -> None:
    pallet = broken_pallet(2, 0.8, 0.6, 0.3)
    assert pallet.mesh.vertices_m[:, 2].min() == pytest.approx(0)
    assert (pallet.length_m, pallet.width_m, pallet.relief_m) == pytest.approx((0.8, 0.6, 0.3))
    inside = pallet.covers(np.array([0.0, 0.6]), np.array([0.0, 0.0]))
    assert inside.tolist() == [True, False]
