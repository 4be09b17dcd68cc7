"""Features in memory: what lies within a radius, and what is forgotten."""

from __future__ import annotations

import math
from uuid import UUID

from hypothesis import example, given
from hypothesis import strategies as st

from contract.geometry import LatLon
from server.geometry.geodesy import distance_m, offset_from
from server.reading.collection import mark_of
from server.reading.tile_cache import Found, Served, TileCache, TileChange, TileFeatures, around, in_order

NOW_US = 1_000_000
places = st.builds(LatLon, latitude_deg=st.floats(-84, 84), longitude_deg=st.floats(-180, 180))


def served(number: int, place: LatLon, *, expires_at_us: int = NOW_US + 1, size: int = 100) -> Served:
    mark = mark_of(UUID(int=number), 1)
    return Served(mark, place.latitude_deg, place.longitude_deg, expires_at_us, b"x" * size)


def on_ring(centre: LatLon, azimuth_rad: float, radius_m: float) -> LatLon:
    return offset_from(centre, radius_m * math.sin(azimuth_rad), radius_m * math.cos(azimuth_rad))


def tiles_of(features: list[Served]) -> list[TileFeatures]:
    """Features in tiles that end at the antimeridian, as all tiles do."""
    sides = [[item for item in features if (item.longitude_deg < 0) is is_west] for is_west in (False, True)]
    return [TileFeatures(1, side) for side in sides]


def within(tile: TileFeatures, centre: LatLon, radius_m: float) -> list[Found]:
    circle = around(centre, radius_m)
    return in_order(tile.about(circle, NOW_US), circle)


def number_of(item: Found) -> int:
    return int.from_bytes(item[1][:16])


@given(places, st.lists(st.tuples(st.floats(-2500, 2500), st.floats(-2500, 2500)), max_size=20), st.floats(1, 2000))
@example(LatLon(latitude_deg=-16.8, longitude_deg=180.0), [(-50.0, 0.0), (50.0, 0.0)], 60.0)
def test_what_lies_within_a_radius_is_what_the_geodesic_says(
    centre: LatLon, offsets_m: list[tuple[float, float]], radius_m: float
) -> None:
    placed = [offset_from(centre, east_m, north_m) for east_m, north_m in offsets_m]
    circle = around(centre, radius_m)
    tiles = tiles_of([served(number, place) for number, place in enumerate(placed)])
    about = [item for tile in tiles for item in tile.about(circle, NOW_US)]
    found = {number_of(item): item[0] for item in in_order(about, circle)}
    wanted = {n: distance_m(place, centre) for n, place in enumerate(placed) if distance_m(place, centre) <= radius_m}
    assert found.keys() == wanted.keys()
    assert all(abs(found[n] - wanted[n]) <= circle.metric.error_m(radius_m) for n in found)


@given(places, st.lists(st.tuples(st.integers(0, 359), st.floats(-1e-4, 1e-4)), max_size=12), st.floats(1, 1900))
@example(LatLon(latitude_deg=0.0, longitude_deg=180.0), [(0, 0.0), (181, 0.0)], 1.0)
def test_near_ties_are_in_the_order_of_the_geodesic_and_then_of_the_id(
    centre: LatLon, directions: list[tuple[int, float]], radius_m: float
) -> None:
    """All lie on a ring to a tenth of a millimetre, where the local metric may be off by more."""
    ring = [
        offset_from(
            centre, (radius_m + off_m) * math.sin(math.radians(deg)), (radius_m + off_m) * math.cos(math.radians(deg))
        )
        for deg, off_m in directions
    ]
    twice = [*ring, *ring]
    tiles = tiles_of([served(len(twice) - number, place) for number, place in enumerate(twice)])
    circle = around(centre, 2000)
    found = in_order((item for tile in tiles for item in tile.about(circle, NOW_US)), circle)
    wanted = sorted((distance_m(centre, place), len(twice) - number) for number, place in enumerate(twice))
    assert [number_of(item) for item in found] == [number for _, number in wanted]


@given(st.lists(st.tuples(st.integers(1, 6), st.booleans()), max_size=30))
def test_a_tile_changed_again_and_again_holds_what_a_new_one_would(changes: list[tuple[int, bool]]) -> None:
    here = LatLon(latitude_deg=38.0, longitude_deg=21.0)
    tile, known = TileFeatures(0, []), dict[int, Served]()
    for seq, (number, is_there) in enumerate(changes, start=1):
        item = served(number, here, size=seq) if is_there else None
        tile.apply(TileChange(seq, UUID(int=number).bytes, item))
        known.pop(number, None)
        if item is not None:
            known[number] = item
    anew = TileFeatures(tile.version, known.values())
    assert sorted(within(tile, here, 1)) == sorted(within(anew, here, 1))
    assert tile.size_bytes == anew.size_bytes


def test_what_has_expired_is_not_served() -> None:
    here = LatLon(latitude_deg=38.0, longitude_deg=21.0)
    tile = TileFeatures(1, [served(1, here), served(2, here, expires_at_us=NOW_US)])
    assert [number_of(item) for item in within(tile, here, 10)] == [1]


def test_changes_replace_and_drop_features() -> None:
    here, there = LatLon(latitude_deg=38.0, longitude_deg=21.0), LatLon(latitude_deg=38.0001, longitude_deg=21.0)
    tile = TileFeatures(4, [served(1, here), served(2, here)])
    assert len(within(tile, here, 1)) == 2
    tile.apply(TileChange(5, UUID(int=1).bytes, None))
    tile.apply(TileChange(6, UUID(int=2).bytes, served(2, there)))
    tile.apply(TileChange(7, UUID(int=3).bytes, served(3, here, size=50)))
    assert [number_of(item) for item in within(tile, here, 1)] == [3]
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
