"""Overlaps of boxes, held against shapely's."""

from __future__ import annotations

import math

import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from shapely.affinity import rotate, translate

from contract.geometry import Box
from server.geometry.footprint import overlap_of_smaller, union_over_intersection
from server.geometry.geodesy import EastNorth


def _box(length_mm: int, width_mm: int, yaw_rad: float) -> Box:
    return Box(length_mm=max(length_mm, width_mm), width_mm=min(length_mm, width_mm), yaw_rad=yaw_rad, relief_mm=50)


sides_mm = st.integers(50, 20_000)
boxes = st.builds(_box, sides_mm, sides_mm, st.floats(0, math.pi, exclude_max=True))
offsets_m = st.floats(-15, 15)


def polygon_of(box: Box) -> shapely.Polygon:
    upright = shapely.box(-box.length_mm / 2, -box.width_mm / 2, box.length_mm / 2, box.width_mm / 2)
    return rotate(upright, box.yaw_rad, origin=(0, 0), use_radians=True)


@given(boxes, boxes)
def test_two_boxes_about_one_centre_overlap_as_their_polygons_do(a: Box, b: Box) -> None:
    union, intersection = polygon_of(a).union(polygon_of(b)).area, polygon_of(a).intersection(polygon_of(b)).area
    assert union_over_intersection(a, b, ignore_yaw=False) == pytest.approx(union / intersection, rel=1e-9)


@given(boxes)
def test_a_box_is_all_of_itself(box: Box) -> None:
    assert union_over_intersection(box, box, ignore_yaw=False) == pytest.approx(1.0, rel=1e-12)


@given(boxes, boxes, offsets_m, offsets_m)
def test_a_box_elsewhere_covers_the_share_of_the_smaller_that_its_polygon_does(
    a: Box, b: Box, east_m: float, north_m: float
) -> None:
    moved = translate(polygon_of(a), 1000 * east_m, 1000 * north_m)
    share = moved.intersection(polygon_of(b)).area / min(polygon_of(a).area, polygon_of(b).area)
    assert overlap_of_smaller(a, b, EastNorth(east_m, north_m)) == pytest.approx(share, abs=1e-9)
