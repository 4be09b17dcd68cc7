"""Features in memory: what lies within a radius, and what is forgotten."""

from __future__ import annotations

from uuid import UUID

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from contract.geometry import LatLon
from server.geodesy import distance_m, metres_per_degree, offset_from
from server.tile_cache import Served, TileCache, TileChange, TileFeatures

NOW_US = 1_000_000
places = st.builds(LatLon, latitude_deg=st.floats(-84, 84), longitude_deg=st.floats(-180, 180))


def served(number: int, place: LatLon, *, expires_at_us: int = NOW_US + 1, size: int = 100) -> Served:
    body = b"x" * size
    return Served(UUID(int=number), place.latitude_deg, place.longitude_deg, expires_at_us, b"mark", body)


@given(places, st.lists(st.tuples(st.floats(-2500, 2500), st.floats(-2500, 2500)), max_size=20), st.floats(1, 2000))
@example(LatLon(latitude_deg=-16.8, longitude_deg=180.0), [(-50.0, 0.0), (50.0, 0.0)], 60.0)
def test_what_lies_within_a_radius_is_what_the_geodesic_says(
    centre: LatLon, offsets_m: list[tuple[float, float]], radius_m: float
) -> None:
    around = [offset_from(centre, east_m, north_m) for east_m, north_m in offsets_m]
    tile = TileFeatures(1, [served(number, place) for number, place in enumerate(around)])
    found = {item.identifier.int: apart_m for apart_m, item in tile.within(centre, radius_m, NOW_US)}
    wanted = {n: distance_m(place, centre) for n, place in enumerate(around) if distance_m(place, centre) <= radius_m}
    assert found == pytest.approx(wanted, rel=1e-5, abs=1e-6)


def test_the_metric_is_the_ellipsoids() -> None:
    """Lengths of a degree at 60 degrees north, from the usual tables: 111,412 m and 55,800 m."""
    north_m, east_m, _ = metres_per_degree(60.0)
    assert (north_m, east_m) == (pytest.approx(111_412, abs=1), pytest.approx(55_800, abs=1))


def test_what_has_expired_is_not_served() -> None:
    here = LatLon(latitude_deg=38.0, longitude_deg=21.0)
    tile = TileFeatures(1, [served(1, here), served(2, here, expires_at_us=NOW_US)])
    assert [item.identifier.int for _, item in tile.within(here, 10, NOW_US)] == [1]


def test_changes_replace_and_drop_features() -> None:
    here, there = LatLon(latitude_deg=38.0, longitude_deg=21.0), LatLon(latitude_deg=38.0001, longitude_deg=21.0)
    tile = TileFeatures(4, [served(1, here), served(2, here)])
    assert len(tile.within(here, 1, NOW_US)) == 2
    tile.apply(TileChange(5, UUID(int=1), None))
    tile.apply(TileChange(6, UUID(int=2), served(2, there)))
    tile.apply(TileChange(7, UUID(int=3), served(3, here, size=50)))
    assert [item.identifier.int for _, item in tile.within(here, 1, NOW_US)] == [3]
    assert tile.version == 7
    assert tile.size_bytes == TileFeatures(1, [served(2, there), served(3, here, size=50)]).size_bytes


def test_the_least_recently_used_tile_is_forgotten() -> None:
    here = LatLon(latitude_deg=38.0, longitude_deg=21.0)
    one = TileFeatures(1, [served(1, here)])
    cache = TileCache(limit_bytes=2 * one.size_bytes)
    for number in (1, 2):
        cache.put(number, TileFeatures(1, [served(number, here)]))
    assert cache.get(1) is not None
    cache.put(3, TileFeatures(1, [served(3, here)]))
    assert [cache.get(number) is None for number in (1, 2, 3)] == [False, True, False]
    assert cache.size_bytes == 2 * one.size_bytes


def test_one_tile_is_kept_however_large() -> None:
    here = LatLon(latitude_deg=38.0, longitude_deg=21.0)
    cache = TileCache(limit_bytes=10)
    cache.put(1, TileFeatures(1, [served(1, here)]))
    assert cache.get(1) is not None
