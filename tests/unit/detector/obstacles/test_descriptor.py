"""Moments of outlines, and the named numbers made of them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from detector.obstacles.descriptor import describe, fold_yaw, moment_box, polygon_moments

sizes = st.floats(0.1, 3.0)
angles = st.floats(-10, 10)


def ellipse(length: float, width: float, yaw: float, centre: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    t = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    u, v = length / 2 * np.cos(t), width / 2 * np.sin(t)
    c, s = np.cos(yaw), np.sin(yaw)
    return np.column_stack([centre[0] + c * u - s * v, centre[1] + s * u + c * v])


@given(sizes, st.floats(1.1, 3.0), angles, st.floats(-100, 100), st.floats(-100, 100))
def test_the_moment_box_of_an_ellipse_is_its_axes(width: float, ratio: float, yaw: float, x: float, y: float) -> None:
    moments = polygon_moments(ellipse(width * ratio, width, yaw, (x, y)))
    length, across, direction = moment_box(moments)
    assert (length, across) == pytest.approx((width * ratio, width), rel=1e-3)
    assert abs(math.sin(direction - yaw)) < 1e-3
    assert moments.centroid_m == pytest.approx([x, y], abs=1e-6)
    assert moments.area_m2 == pytest.approx(math.pi / 4 * width**2 * ratio, rel=1e-3)


def test_the_orientation_of_a_polygon_does_not_matter() -> None:
    outline = ellipse(1.0, 0.5, 0.4)
    forward, backward = polygon_moments(outline), polygon_moments(outline[::-1])
    assert forward.area_m2 == pytest.approx(backward.area_m2)
    assert forward.covariance_m2 == pytest.approx(backward.covariance_m2)


@given(st.floats(-100, 100))
def test_a_folded_yaw_is_the_same_axis_within_half_a_turn(yaw: float) -> None:
    folded = fold_yaw(yaw)
    assert 0.0 <= folded < math.pi
    assert abs(math.sin(folded - yaw)) < 1e-6


@given(angles, st.floats(-50, 50))
def test_the_descriptor_survives_rotation_and_shift(yaw: float, shift: float) -> None:
    relief, saliency = np.linspace(0.01, 0.12, 50), np.linspace(1.0, 1.4, 50)
    still = describe(ellipse(0.9, 0.6, 0.0), 0.9, 0.6, relief, 0.03, saliency)
    moved = describe(ellipse(0.9, 0.6, yaw, (shift, -shift)), 0.9, 0.6, relief, 0.03, saliency)
    assert moved.values == pytest.approx(still.values, rel=1e-6, abs=1e-6)


def test_the_first_moment_invariant_of_a_disc_is_one_over_two_pi() -> None:
    disc = describe(ellipse(1.0, 1.0, 0.0), 1.0, 1.0, np.ones(3), 0.1, np.ones(3))
    assert disc.values["hu1"] == pytest.approx(1 / (2 * math.pi), rel=1e-3)
    assert disc.values["hu2_root"] == pytest.approx(0.0, abs=1e-9)


def test_a_line_has_no_area_and_still_a_descriptor() -> None:
    line = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    values = describe(line, 2.0, 0.05, np.ones(3), 0.1, np.ones(3)).values
    assert values["area_m2"] == 0.0
    assert all(math.isfinite(v) for v in values.values())
