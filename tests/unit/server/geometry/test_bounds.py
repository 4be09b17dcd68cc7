"""Boxes: parsing, the antimeridian, the poles, and their cover of cells."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from contract.geometry import LatLon
from server.geometry.bounds import Bounds
from server.geometry.quadkey import cell_of

longitudes = st.floats(-180, 180)
latitudes = st.floats(-90, 90)


@st.composite
def boxes(draw: st.DrawFn) -> Bounds:
    south_deg, north_deg = sorted((draw(latitudes), draw(latitudes)))
    width_deg = draw(st.sampled_from([0.0, 1e-6, 0.01, 1.0, 359.0])) * draw(st.floats(0, 1))
    west_deg = draw(longitudes)
    east_deg = west_deg + width_deg
    return Bounds(west_deg, south_deg, east_deg if east_deg <= 180 else east_deg - 360, north_deg)


def holds(bounds: Bounds, latitude_deg: float, longitude_deg: float) -> bool:
    """By the definition of RFC 7946: eastwards from west to east."""
    if not bounds.south_deg <= latitude_deg <= bounds.north_deg:
        return False
    if bounds.west_deg <= bounds.east_deg:
        return bounds.west_deg <= longitude_deg <= bounds.east_deg
    return longitude_deg >= bounds.west_deg or longitude_deg <= bounds.east_deg


@given(boxes(), st.floats(0, 1), st.floats(0, 1))
@example(Bounds(179.99999999999997, 0.0, 179.99999999999997, 0.0), 0.0, 0.0)
def test_every_place_in_a_box_lies_in_its_cover(bounds: Bounds, across: float, up: float) -> None:
    width_deg = (bounds.east_deg - bounds.west_deg) % 360
    longitude_deg = bounds.west_deg + across * width_deg
    longitude_deg = longitude_deg if longitude_deg <= 180 else longitude_deg - 360
    latitude_deg = min(bounds.north_deg, bounds.south_deg + up * (bounds.north_deg - bounds.south_deg))
    cell = cell_of(LatLon(latitude_deg=latitude_deg, longitude_deg=max(-180.0, longitude_deg)))
    assert any(low <= cell <= high for low, high in bounds.cover())


@given(boxes(), latitudes, longitudes)
def test_the_spans_of_longitude_say_what_the_box_holds(
    bounds: Bounds, latitude_deg: float, longitude_deg: float
) -> None:
    inside = bounds.south_deg <= latitude_deg <= bounds.north_deg and any(
        west <= longitude_deg <= east for west, east in bounds.longitude_spans
    )
    if abs(longitude_deg) != 180.0:
        assert inside == holds(bounds, latitude_deg, longitude_deg)
    elif holds(bounds, latitude_deg, -longitude_deg):
        assert inside, "both names of the antimeridian are the same place"


@given(boxes())
def test_a_cover_is_short_ascending_and_disjoint(bounds: Bounds) -> None:
    ranges = bounds.cover()
    assert 1 <= len(ranges) <= 16
    assert all(low <= high for low, high in ranges)
    assert all(before[1] + 1 < after[0] for before, after in pairwise(ranges))


def test_the_cover_of_a_city_block_is_much_smaller_than_the_earth() -> None:
    block = Bounds(21.734, 38.246, 21.736, 38.248)
    cells = sum(high - low + 1 for low, high in block.cover())
    assert cells * 2.4 * 2.4 < 4 * 175 * 222 / 0.6


def test_across_the_antimeridian_both_sides_belong_to_the_box() -> None:
    fiji = Bounds.parsed("179,-20,-179,-15")
    assert fiji.longitude_spans[:2] == ((179.0, 180.0), (-180.0, -179.0))


def test_a_box_that_ends_at_the_antimeridian_holds_it_by_both_names() -> None:
    assert (-180.0, -180.0) in Bounds(170, 0, 180, 1).longitude_spans
    assert (180.0, 180.0) in Bounds(-180, 0, -170, 1).longitude_spans


def test_six_numbers_are_a_box_with_heights() -> None:
    box = Bounds.parsed("1,2,-10,3,4,50", with_heights=True)
    assert (box.west_deg, box.south_deg, box.east_deg, box.north_deg) == (1, 2, 3, 4)
    assert (box.lowest_m, box.highest_m) == (-10, 50)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "1,2,3",
        "1,2,3,4,5",
        "1,2,-10,3,4,50",
        "a,b,c,d",
        "nan,0,1,1",
        "0,0,inf,1",
        "1e1,0,20,1",
        "181,0,1,1",
        "0,2,1,1",
        "0,-91,1,1",
    ],
)
def test_what_is_no_box_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"^bbox: "):
        Bounds.parsed(text)
