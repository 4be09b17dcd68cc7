from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detector.survey.grid import components_of, make_grid, measure_spacing, smooth


@given(pitch=st.floats(1e-4, 0.1), columns=st.integers(20, 80), rows=st.integers(20, 80))
def test_the_spacing_of_a_regular_grid_is_its_pitch(pitch: float, columns: int, rows: int) -> None:
    xy = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2) * pitch
    assert measure_spacing(xy) == pytest.approx(pitch, rel=0.15)


def test_the_spacing_of_scattered_points_is_the_root_of_their_area() -> None:
    xy = np.random.default_rng(1).uniform(0.0, 2.0, (10_000, 2))
    assert measure_spacing(xy) == pytest.approx(0.02, rel=0.05)


def test_a_gap_does_not_change_the_spacing() -> None:
    xy = np.random.default_rng(1).uniform(0.0, 2.0, (10_000, 2))
    assert measure_spacing(xy[(xy[:, 0] < 0.5) | (xy[:, 0] > 1.5)]) == pytest.approx(0.02, rel=0.1)


@pytest.mark.parametrize("copies", [2, 3, 10])
def test_copies_of_points_do_not_change_the_spacing(copies: int) -> None:
    xy = np.random.default_rng(1).uniform(0.0, 2.0, (10_000, 2))
    assert measure_spacing(np.repeat(xy, copies, axis=0)) == measure_spacing(xy)


def test_points_that_coincide_have_no_spacing() -> None:
    assert measure_spacing(np.ones((10, 2))) < 1e-6


@settings(deadline=None)  # the first call may compile
@given(a=st.floats(-1, 1), b=st.floats(-1, 1))
def test_sampling_a_plane_between_cells_gives_the_plane(a: float, b: float) -> None:
    places = np.random.default_rng(2).uniform(0.1, 0.9, (50, 2))
    grid = make_grid(np.array([[0.0, 0.0], [1.0, 1.0]]), 0.125)
    x, y = (grid.origin_m[k] + (np.arange(n) + 0.5) * grid.cell_m for k, n in ((0, grid.shape[1]), (1, grid.shape[0])))
    plane = a * x[None, :] + b * y[:, None]
    assert grid.sample(plane, places) == pytest.approx(a * places[:, 0] + b * places[:, 1], abs=1e-9)


def test_a_far_point_makes_cells_coarser_instead_of_filling_the_memory() -> None:
    grid = make_grid(np.array([[0.0, 0.0], [1e6, 1e6]]), 1e-3)
    assert grid.shape[0] * grid.shape[1] < 200


def test_smoothing_takes_only_what_was_measured() -> None:
    certainty = np.zeros((21, 21))
    certainty[:, :10] = 1.0
    values = np.where(certainty > 0, 3.0, 99.0)
    smoothed, weight = smooth(values, certainty, 1.5)
    assert smoothed[:, :12] == pytest.approx(3.0)
    assert weight[10, 20] == 0.0


def test_cells_that_touch_by_a_corner_are_connected_only_diagonally() -> None:
    mask = np.eye(3, dtype=bool)
    assert components_of(mask)[1] == 3
    assert components_of(mask, diagonal=True)[1] == 1
