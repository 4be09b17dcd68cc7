"""Covers hold every point of their circle, everywhere on Earth."""

from __future__ import annotations

import tracemalloc

import pytest
from geographiclib.geodesic import Geodesic
from hypothesis import example, given, settings
from hypothesis import strategies as st

from contract.geometry import LatLon
from server.geometry.quadkey import CELL_ZOOM, cell_of, cover, shard_of_cell, tile_of_cell, tiles

latitudes = st.floats(-90, 90)
longitudes = st.floats(-180, 180)
radii = st.floats(0.1, 50_000)


@given(latitudes, longitudes, radii, st.floats(0, 360), st.floats(0, 1))
@example(0.0, 180.0, 1_000.0, 90.0, 1.0)
@example(0.0, -180.0, 50_000.0, 270.0, 1.0)
@example(90.0, 0.0, 50_000.0, 0.0, 1.0)
@example(-89.9, 30.0, 50_000.0, 180.0, 1.0)
@example(85.05, 179.999, 10_000.0, 90.0, 1.0)
@settings(max_examples=400, deadline=None)
def test_a_cover_holds_every_point_of_its_circle(
    latitude_deg: float, longitude_deg: float, radius_m: float, azimuth_deg: float, share: float
) -> None:
    centre = LatLon(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
    there = Geodesic.WGS84.Direct(latitude_deg, longitude_deg, azimuth_deg, share * radius_m)
    cell = cell_of(LatLon(latitude_deg=there["lat2"], longitude_deg=there["lon2"]))
    ranges = cover(centre, radius_m)
    assert any(low <= cell <= high for low, high in ranges)


@given(latitudes, longitudes, radii)
@settings(max_examples=200, deadline=None)
def test_a_cover_is_a_handful_of_ascending_disjoint_ranges(
    latitude_deg: float, longitude_deg: float, radius_m: float
) -> None:
    ranges = cover(LatLon(latitude_deg=latitude_deg, longitude_deg=longitude_deg), radius_m)
    assert 1 <= len(ranges) <= 16
    bounds = [bound for pair in ranges for bound in pair]
    assert bounds == sorted(bounds)
    assert 0 <= bounds[0] <= bounds[-1] < 4**CELL_ZOOM


@given(st.floats(-84, 84), longitudes, st.floats(0, 360), st.floats(0, 250))
@settings(max_examples=200, deadline=None)
def test_the_tiles_of_a_circle_hold_the_tile_of_every_point(
    latitude_deg: float, longitude_deg: float, azimuth_deg: float, radius_m: float
) -> None:
    centre = LatLon(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
    there = Geodesic.WGS84.Direct(latitude_deg, longitude_deg, azimuth_deg, radius_m)
    point = LatLon(latitude_deg=there["lat2"], longitude_deg=there["lon2"])
    found = tiles(centre, 250)
    assert tile_of_cell(cell_of(point)) in found
    assert list(found) == sorted(set(found))


def test_a_small_circle_has_a_tight_cover() -> None:
    ranges = cover(LatLon(latitude_deg=38.2466, longitude_deg=21.7346), 300)
    cells = sum(high - low + 1 for low, high in ranges)
    cell_side_m = 40_075_016 / 2**CELL_ZOOM * 0.785
    assert cells * cell_side_m**2 < 16 * 600**2


@pytest.mark.parametrize(
    ("latitude_deg", "longitude_deg", "quadkey"),
    # The example of the published tile system: tile (3, 5) at zoom 3 is quadkey 213.
    [(-45.0, -40.0, "213")],
)
def test_a_cell_begins_with_the_digits_of_its_quadkey(latitude_deg: float, longitude_deg: float, quadkey: str) -> None:
    cell = cell_of(LatLon(latitude_deg=latitude_deg, longitude_deg=longitude_deg))
    assert cell >> 2 * (CELL_ZOOM - len(quadkey)) == int(quadkey, 4)
    assert shard_of_cell(cell) >> 6 == int(quadkey, 4)


def test_both_sides_of_the_antimeridian_are_in_one_cover() -> None:
    ranges = cover(LatLon(latitude_deg=-16.8, longitude_deg=179.9999), 1_000)
    west = cell_of(LatLon(latitude_deg=-16.8, longitude_deg=-179.999))
    assert any(low <= west <= high for low, high in ranges)


def test_circles_that_touch_thousands_of_tiles_are_not_remembered() -> None:
    tracemalloc.start()
    try:
        for step in range(50):
            assert len(tiles(LatLon(latitude_deg=84.9, longitude_deg=-170 + step), 10_000)) > 1_000
        held_bytes, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert (
        held_bytes < 4_000_000
    )  # remembered they would be 18 MB; the rest are columns and rows, whose number is limited
