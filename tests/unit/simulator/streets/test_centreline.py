from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.streets.centreline import Centreline, alignment, straight

RADII = st.floats(30.0, 400.0)
SIDES = st.sampled_from([-1.0, 1.0])


def arc(radius_m: float, side: float) -> Centreline:
    curvature = side / radius_m
    return alignment([(0.0, curvature), (100.0, curvature)], [(0.0, 0.0), (100.0, 3.0)])


@given(RADII, SIDES)
@settings(max_examples=40)
def test_constant_curvature_is_a_circle(radius_m: float, side: float) -> None:
    line = arc(radius_m, side)
    s = np.linspace(0.0, 100.0, 37)
    centre = np.array([0.0, side * radius_m])
    at = line.at(s)
    assert np.hypot(*(at.position_m[:, :2] - centre).T) == pytest.approx(np.full(37, radius_m), abs=1e-3)
    assert np.unwrap(at.heading_rad) == pytest.approx(side * s / radius_m, abs=1e-4)
    assert at.curvature_per_m[3:-3] == pytest.approx(np.full(31, side / radius_m), rel=0.01)


@given(RADII, SIDES, st.lists(st.tuples(st.floats(2, 98), st.floats(-12, 12)), min_size=1, max_size=30))
@settings(max_examples=40)
def test_projection_is_the_inverse_of_the_plan(radius_m: float, side: float, places: list[tuple[float, float]]) -> None:
    line = arc(radius_m, side)
    s, t = np.array(places).T
    again_s, again_t = line.project(line.plan(s, t))
    assert again_s == pytest.approx(s, abs=1e-5)
    assert again_t == pytest.approx(t, abs=1e-5)


def test_a_clothoid_turns_by_the_area_under_its_curvature() -> None:
    line = alignment([(0.0, 0.0), (20.0, 0.02), (50.0, 0.02), (70.0, 0.0), (90.0, 0.0)], [(0.0, 1.0)])
    assert line.at(np.array([90.0])).heading_rad[0] == pytest.approx(0.02 * 50.0, abs=1e-4)
    assert line.at(np.array([10.0])).curvature_per_m[0] == pytest.approx(0.01, rel=0.01)
    assert line.at(np.array([45.0])).position_m[0, 2] == 1.0


def test_heights_are_joined_without_overshoot_and_the_grade_is_their_slope() -> None:
    line = alignment([(0.0, 0.0), (200.0, 0.0)], [(0.0, 0.0), (80.0, 4.0), (200.0, 4.0)])
    z = line.at(np.linspace(0, 200, 201)).position_m[:, 2]
    assert z.min() >= -1e-9
    assert z.max() <= 4.0 + 1e-6
    assert line.at(np.array([40.0])).grade[0] == pytest.approx((z[41] - z[39]) / 2, rel=0.01)


def test_left_is_left() -> None:
    assert straight(-10.0, 50.0).plan(np.array([3.0]), np.array([2.0]))[0] == pytest.approx([3.0, 2.0])


@pytest.mark.parametrize(
    ("s", "points"),
    [
        ([0.0, 1.0, 2.0], np.zeros((3, 3))),
        ([0.0, 1.0, 1.0, 2.0], np.zeros((4, 3))),
        ([0.0, 1.0, 2.0, 3.0], np.full((4, 3), math.nan)),
    ],
)
def test_a_line_that_is_none_is_refused(s: list[float], points: np.ndarray) -> None:
    with pytest.raises(ValueError, match="at least four finite points"):
        Centreline(np.array(s), points)
