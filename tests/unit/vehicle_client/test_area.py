"""Areas: what surely lies inside, and distances that agree with geodesics."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.geometry import LatLon
from tests.unit.vehicle_client.making import ORIGIN, PATRAS
from vehicle_client.area import Area, Strip, distance_m, offset_m
from vehicle_client.frames import GeoOrigin
from vehicle_client.link.course import LEAST_WAY_M, Course

metres = st.floats(-2_000, 2_000)


def at(east_m: float, north_m: float, origin: GeoOrigin = ORIGIN) -> LatLon:
    return origin.geodetic(np.array([east_m, north_m, 0.0]))[0]


@given(metres, metres, st.floats(-84, 84), st.floats(-180, 180))
def test_offsets_are_those_of_the_ellipsoid(east_m: float, north_m: float, lat: float, lon: float) -> None:
    origin = LatLon(latitude_deg=lat, longitude_deg=lon)
    there = at(east_m, north_m, GeoOrigin(origin, 0.0))
    # Meridians converge: within the square of the way, over the ellipsoid's radius, times the latitude's tangent.
    off_m = 0.1 + math.hypot(east_m, north_m) ** 2 / 6.3e6 * (1 + abs(math.tan(math.radians(lat))))
    assert offset_m(origin, there) == pytest.approx((east_m, north_m), abs=off_m)
    assert distance_m(origin, there) == pytest.approx(distance_m(there, origin))


def test_the_antimeridian_is_no_border() -> None:
    west, east = LatLon(latitude_deg=10, longitude_deg=179.9995), LatLon(latitude_deg=10, longitude_deg=-179.9995)
    assert distance_m(west, east) == pytest.approx(109.6, abs=0.2)
    assert Area(west, 200.0).surely_holds(east)


@pytest.mark.parametrize(("north_m", "inside"), [(0, True), (598, True), (599.9, False), (601, False)])
def test_a_circle_holds_what_is_within_but_for_its_edge(north_m: float, inside: bool) -> None:
    assert Area(PATRAS, 600.0).surely_holds(at(0, north_m)) is inside


@pytest.mark.parametrize(
    ("ahead_m", "right_m", "inside"),
    [
        (100, 0, True),
        (-100, 0, False),
        (0.5, 0, False),
        (100, 240, True),
        (100, -240, True),
        (100, 260, False),
        (990, 0, True),
        (1010, 0, False),
    ],
)
@given(heading_rad=st.floats(0, 2 * math.pi))
def test_a_strip_holds_what_is_ahead(ahead_m: float, right_m: float, inside: bool, heading_rad: float) -> None:
    sin, cos = math.sin(heading_rad), math.cos(heading_rad)
    place = at(ahead_m * sin + right_m * cos, ahead_m * cos - right_m * sin)
    assert Area(PATRAS, 1000.0, Strip(heading_rad, 500.0)).surely_holds(place) is inside


def test_the_course_is_that_of_the_last_metres_and_stays_while_the_car_stands() -> None:
    course = Course()
    assert course.after(PATRAS).heading_rad is None
    for north_m in range(0, 100, 10):
        course = course.after(at(0, north_m))
    assert course.heading_rad == pytest.approx(0, abs=1e-6)
    for east_m in range(0, 100, 10):
        course = course.after(at(east_m, 90))
    assert course.heading_rad == pytest.approx(math.pi / 2, abs=0.01)
    standing = course
    for shaking_m in (1.0, -2.0, LEAST_WAY_M / 4):
        standing = standing.after(at(90 + shaking_m, 90))
    assert standing.heading_rad == course.heading_rad
