from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.streets.centreline import alignment
from simulator.streets.road import OVERLAP_M, Road, Section, side_road, straight_road


def curved(radius_m: float) -> Road:
    return Road(alignment([(0.0, 1 / radius_m), (120.0, 1 / radius_m)], [(0.0, 0.0), (120.0, 0.0)]))


def test_a_road_falls_to_both_sides_by_its_crown() -> None:
    road = straight_road(100.0, 0.0)
    s = np.full(3, 50.0)
    middle, left, right = road.height(s, np.array([0.0, 3.0, -3.0]))
    assert left == pytest.approx(right)
    assert (middle - left) / 3.0 == pytest.approx(0.02, rel=0.1)


@pytest.mark.parametrize("radius_m", [60.0, -60.0, 150.0])
def test_curves_lean_inwards(radius_m: float) -> None:
    road = curved(radius_m)
    outer = -math.copysign(3.0, radius_m)
    inside, outside = road.height(np.full(2, 60.0), np.array([-outer, outer]))
    assert (outside - inside) / 6.0 == pytest.approx(min(2.5 / abs(radius_m), 0.04), rel=0.05)


@given(st.floats(-3.4, 3.4))
@settings(max_examples=30)
def test_the_cross_slope_is_the_derivative_of_the_height(t_m: float) -> None:
    road = curved(80.0)
    s, t = np.array([55.0]), np.array([t_m])
    slope = (road.height(s, t + 1e-4) - road.height(s, t - 1e-4)) / 2e-4
    assert road.cross_slope(s, t) == pytest.approx(slope, abs=2e-3)


@pytest.mark.parametrize("side", [1, -1])
def test_a_side_road_meets_the_main_roads_edge_without_a_step(side: int) -> None:
    main, arm = side_road(straight_road(200.0, 0.0), 100.0, side, 0.3, 90.0, 0.05, Section(lane_width_m=3.0))
    t = np.linspace(-6.0, 6.0, 25)
    s = np.full(25, arm.line.start_m + OVERLAP_M)
    along, across = main.line.project(arm.line.plan(s, t))
    assert np.abs(across) == pytest.approx(np.full(25, 3.5), abs=0.02)
    assert arm.height(s, t) == pytest.approx(main.height(along, np.clip(across, -3.5, 3.5)), abs=2e-3)
    (opening,) = main.openings
    assert opening.side == side
    assert opening.end_m - opening.start_m == pytest.approx(2 * float(arm.half_width(s[:1])[0]))


def test_the_mouth_of_a_side_road_is_rounded_and_narrows_to_its_lanes() -> None:
    _, arm = side_road(straight_road(200.0, 0.0), 100.0, 1, 0.0, 90.0, 0.0, Section(lane_width_m=3.0))
    widths = arm.half_width(np.array([0.0, 2.0, 4.0, 10.0]))
    assert widths[0] == pytest.approx(3.0 + arm.mouth_radius_m)
    assert (np.diff(widths) < 0).all()
    assert widths[-1] == pytest.approx(3.0)


def test_lanes_are_counted_from_the_right() -> None:
    section = Section(lanes=(1, 1, -1), lane_width_m=3.0)
    assert [section.lane_offset_m(lane) for lane in range(3)] == pytest.approx([-3.0, 0.0, 3.0])
