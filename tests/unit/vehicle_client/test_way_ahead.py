"""The way ahead: places by a bend have the length of its arc and the distance from it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle_client.way_ahead import BEND_RAD, CHANGES_WITHIN_M, HALF_LANE_M, Bend, along_bend, on_way, straight_on

curvatures = st.floats(0.001, 0.2) | st.floats(-0.2, -0.001)


def on_arc(along_m: float, left_m: float, curvature_per_m: float) -> np.ndarray:
    """A place so far along a circle through the car, and so far to its left."""
    turned = along_m * curvature_per_m
    left = np.array([-math.sin(turned), math.cos(turned)])
    return np.array([math.sin(turned), 1 - math.cos(turned)]) / curvature_per_m + left_m * left


@given(curvatures, st.floats(0.01, 1.0), st.floats(-0.9, 0.9))
def test_a_place_on_the_bend_has_the_arc_before_it_and_its_distance_beside_it(
    curvature_per_m: float, share: float, beside: float
) -> None:
    along_m, left_m = share * BEND_RAD / abs(curvature_per_m), beside * min(3.0, 1 / abs(curvature_per_m))
    way = along_bend(on_arc(along_m, left_m, curvature_per_m), curvature_per_m)
    assert way == pytest.approx((along_m, left_m), abs=1e-6)


@given(curvatures, st.floats(0, 100), st.floats(-3, 3))
def test_beyond_the_bend_the_way_goes_straight_on(curvature_per_m: float, beyond_m: float, left_m: float) -> None:
    end_m = BEND_RAD / abs(curvature_per_m)
    turned = math.copysign(BEND_RAD, curvature_per_m)
    axes = np.array([[math.cos(turned), math.sin(turned)], [-math.sin(turned), math.cos(turned)]])
    place = on_arc(end_m, 0.0, curvature_per_m) + np.array([beyond_m, left_m]) @ axes
    if place[0] > 0:
        assert along_bend(place, curvature_per_m) == pytest.approx((end_m + beyond_m, left_m), abs=1e-6)


@given(st.floats(-100, -0.01) | st.just(0.0) | st.floats(0.01, 400), st.floats(-50, 50), curvatures)
def test_what_is_behind_stays_behind_and_left_and_right_are_alike(x: float, y: float, curvature_per_m: float) -> None:
    along_m, left_m = along_bend(np.array([x, y]), curvature_per_m)
    assert (along_m > 0) == (x > 0)
    assert x > 0 or (along_m, left_m) == (x, y)
    assert along_bend(np.array([x, -y]), -curvature_per_m) == pytest.approx((along_m, -left_m))


@given(st.floats(-100, 400), st.floats(-50, 50), st.sampled_from([0.0, 1e-7, -1e-7]))
def test_without_a_bend_the_way_is_straight(x: float, y: float, curvature_per_m: float) -> None:
    place = np.array([x, y, 0.3])
    assert along_bend(place, curvature_per_m) == straight_on(place) == on_way(place, curvature_per_m) == (x, y)


def test_also_a_bend_of_2_km_leads_elsewhere() -> None:
    assert along_bend(np.array([200.0, 0.0]), 1 / 2_000).left_m == pytest.approx(-10.0, abs=0.1)


@given(st.floats(0.1, 400), st.floats(-50, 50), curvatures)
def test_bends_begin_and_end_so_that_either_way_counts(x: float, y: float, curvature_per_m: float) -> None:
    place = np.array([x, y])
    left_m = on_way(place, curvature_per_m).left_m
    assert abs(left_m) == min(abs(y), abs(along_bend(place, curvature_per_m).left_m))


@given(st.floats(1, CHANGES_WITHIN_M))
def test_a_bend_that_changes_leads_elsewhere_by_the_square_of_the_way(along_m: float) -> None:
    changed = along_bend(on_arc(along_m, 0.0, 0.01 + 1e-4), 0.01)
    assert Bend(0.01, 1e-4).beside_sd_m(along_m) == pytest.approx(changed.left_m, rel=0.1)


@given(st.floats(0, 0.1), st.floats(0, CHANGES_WITHIN_M), st.floats(CHANGES_WITHIN_M, 400))
def test_what_a_change_makes_unsure_grows_until_it_has_changed_and_no_wider_than_half_a_lane(
    sd_per_m: float, near_m: float, far_m: float
) -> None:
    bend = Bend(0.0, sd_per_m)
    assert (
        bend.beside_sd_m(near_m) <= bend.beside_sd_m(far_m) == bend.beside_sd_m(CHANGES_WITHIN_M) <= HALF_LANE_M == 1.75
    )
