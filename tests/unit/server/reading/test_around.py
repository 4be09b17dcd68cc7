"""What lies around and ahead, against solving every geodesic."""

from __future__ import annotations

import math
from uuid import UUID

import numpy as np
import pytest
from geographiclib.geodesic import Geodesic
from hypothesis import given, settings
from hypothesis import strategies as st

from contract.geometry import LatLon
from server.reading.around import Ahead, Circle, Key, geodesic, nearest

# The brute force: (distance, azimuth) of places about a centre, chosen by the direct problem.
polar = st.lists(
    st.tuples(
        st.one_of(st.floats(0, 60_000), st.sampled_from([0.0, 50.0, 1_000.0, 50_000.0])),
        st.one_of(st.floats(-180, 180), st.sampled_from([-90.0, 0.0, 90.0, 180.0])),
    ),
    max_size=25,
)
centres = st.builds(
    LatLon,
    latitude_deg=st.one_of(st.floats(-90, 90), st.sampled_from([0.0, 89.9999, -89.9999, 90.0, -90.0])),
    longitude_deg=st.one_of(st.floats(-180, 180), st.sampled_from([-180.0, 0.0, 179.9999, 180.0])),
)
directions = st.none() | st.builds(
    Ahead, heading_rad=st.floats(0, 2 * math.pi), width_m=st.none() | st.floats(0.1, 100_000)
)
circles = st.builds(Circle, centre=centres, radius_m=st.floats(1, 50_000), ahead=directions)


def places(centre: LatLon, offsets: list[tuple[float, float]]) -> np.ndarray:
    solved = [Geodesic.WGS84.Direct(centre.latitude_deg, centre.longitude_deg, a, d) for d, a in offsets]
    return np.array([(item["lat2"], item["lon2"]) for item in solved]).reshape(-1, 2)


def ids(number: int) -> list[UUID]:
    return [UUID(int=(7 * index) % 31) for index in range(number)]


def brute_force(circle: Circle, places_deg: np.ndarray) -> list[Key]:
    keys = []
    for identifier, place in zip(ids(len(places_deg)), places_deg, strict=True):
        distance_m, azimuth_rad = geodesic(circle.centre, *map(float, place))
        if distance_m > circle.radius_m:
            continue
        if circle.ahead is not None:
            turn_rad = azimuth_rad - circle.ahead.heading_rad
            if distance_m * math.cos(turn_rad) < -1e-9:
                continue
            width_m = circle.ahead.width_m
            if width_m is not None and abs(distance_m * math.sin(turn_rad)) > width_m / 2:
                continue
        keys.append(Key(distance_m, identifier))
    return sorted(keys)


@settings(max_examples=150, deadline=None)
@given(circles, polar)
def test_the_nearest_are_those_that_all_geodesics_say(circle: Circle, offsets: list[tuple[float, float]]) -> None:
    places_deg = places(circle.centre, offsets)
    assert list(nearest(circle, ids(len(offsets)), places_deg, None)) == brute_force(circle, places_deg)


@settings(max_examples=60, deadline=None)
@given(circles, polar, st.integers(1, 5))
def test_pages_put_together_are_the_whole(circle: Circle, offsets: list[tuple[float, float]], size: int) -> None:
    places_deg = places(circle.centre, offsets)
    found: list[Key] = []
    after: Key | None = None
    while page := [
        key for key, _ in zip(nearest(circle, ids(len(offsets)), places_deg, after), range(size), strict=False)
    ]:
        found += page
        after = page[-1]
        assert len(found) <= len(offsets), "a page repeats what was on another"
    assert found == brute_force(circle, places_deg)


def test_a_corridor_has_its_full_width_and_nothing_behind() -> None:
    ahead = Ahead(heading_rad=math.radians(90), width_m=10.0)
    east, north = math.radians(90), 0.0
    assert ahead.holds(100.0, east)
    assert not ahead.holds(100.0, -east)
    assert ahead.holds(4.99, north)
    assert not ahead.holds(5.01, north)
    slightly_left = east - math.asin(5.01 / 1000)
    assert not ahead.holds(1000.0, slightly_left)


def test_without_a_width_all_in_front_is_ahead() -> None:
    ahead = Ahead(heading_rad=0.0)
    assert ahead.holds(1e4, math.radians(89.99))
    assert not ahead.holds(1e4, math.radians(90.01))


@pytest.mark.parametrize("longitude_deg", [180.0, -180.0, 179.99999])
def test_a_circle_crosses_the_antimeridian(longitude_deg: float) -> None:
    circle = Circle(LatLon(latitude_deg=-16.8, longitude_deg=longitude_deg), 100.0)
    places_deg = np.array([(-16.8, -179.9998), (-16.8, 179.9998), (-16.8, 0.0)])
    assert len(list(nearest(circle, ids(3), places_deg, None))) == 2
