"""The spatial key: Morton code of a web-mercator tile (a quadkey as a 64-bit integer).

At zoom 24 a tile is 2.4 m wide at the equator; its Morton code is an obstacle's `cell`. Every tile of a lower zoom is
one contiguous range of cells, so a circle is covered by a handful of ranges on one B-tree.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache
from typing import NamedTuple

from contract.geometry import LatLon

Ranges = tuple[tuple[int, int], ...]

CELL_ZOOM = 24
TILE_ZOOM = 14
SHARD_ZOOM = 6

# The smallest radius of curvature of the WGS 84 ellipsoid (meridian, at the equator) makes every cover an outer one.
LEAST_EARTH_RADIUS_M = 6_335_439.0
MERCATOR_LATITUDE_DEG = 85.0511287798066
_SIDE = 1 << CELL_ZOOM
_COVER_SIDE, _COVER_BITS = 4, 2
# A row is rounded like a few units in the last place of 90.
_ROUNDING_DEG = 1e-9
# Columns and rows of tiles, whose bits are spread on the way of every query.
_REMEMBERED = 1 << 15
# Vehicles report from the same streets; a cover takes half a kilobyte.
_REMEMBERED_COVERS = 1 << 13


def cell_of(position: LatLon) -> int:
    """Morton code of the position's tile at zoom 24."""
    return _spread(_column(position.longitude_deg) % _SIDE) | _spread(_row(position.latitude_deg)) << 1


def tile_of_cell(cell: int) -> int:
    """Morton code at zoom 14 of the tile that holds a cell."""
    return cell >> 2 * (CELL_ZOOM - TILE_ZOOM)


def cells_of_tile(tile: int) -> tuple[int, int]:
    """First and last cell of a tile at zoom 14."""
    shift = 2 * (CELL_ZOOM - TILE_ZOOM)
    return tile << shift, ((tile + 1) << shift) - 1


def shard_of_tile(tile: int) -> int:
    """Leading six quadkey digits (12 bits) of a tile at zoom 14."""
    return tile >> 2 * (TILE_ZOOM - SHARD_ZOOM)


def shard_of_cell(cell: int) -> int:
    """Leading six quadkey digits (12 bits) of a cell."""
    return shard_of_tile(tile_of_cell(cell))


def cover(centre: LatLon, radius_m: float) -> Ranges:
    """Ascending, disjoint, inclusive ranges of cells that hold every point within `radius_m` of `centre`.

    At most 4 x 4 tiles of one zoom; wraps in x across the antimeridian, clamps in y beyond the last mercator row.
    """
    return window(centre, radius_m).cover()


def tiles(centre: LatLon, radius_m: float) -> tuple[int, ...]:
    """Ascending Morton codes of the tiles of zoom 14 that a circle touches."""
    return window(centre, radius_m).tiles()


def merged(ranges: Iterable[tuple[int, int]]) -> Ranges:
    """The same cells as ascending ranges that neither overlap nor touch."""
    joined: list[tuple[int, int]] = []
    for low, high in sorted(set(ranges)):
        if joined and low <= joined[-1][1] + 1:
            joined[-1] = (joined[-1][0], max(high, joined[-1][1]))
        else:
            joined.append((low, high))
    return tuple(joined)


class Window(NamedTuple):
    """A box, as about a circle, in columns and rows of cells, both ends included.

    Columns count from the antimeridian, and go on beyond it. Those of a lower zoom are the same numbers with fewer
    bits.
    """

    west: int
    east: int
    top: int
    bottom: int

    def tiles(self) -> tuple[int, ...]:
        """Ascending Morton codes of the tiles of zoom 14 that the window touches."""
        dropped = CELL_ZOOM - TILE_ZOOM
        # Near a pole a circle touches thousands: whoever asks for many such ones must not fill the memory.
        return (_remembered_codes if self._fits(dropped) else _codes)(*self._coarse(dropped))

    def cover(self) -> Ranges:
        """The ranges of cells of the finest zoom at which the window is at most 4 x 4 tiles."""
        dropped = max(0, max(self.east - self.west, self.bottom - self.top).bit_length() - _COVER_BITS)
        while not self._fits(dropped):
            dropped += 1
        return _ranges(*self._coarse(dropped))

    def _fits(self, dropped: int) -> bool:
        """Whether a cover is small enough whose columns and rows lack that many bits."""
        columns = (self.east >> dropped) - (self.west >> dropped)
        return columns < _COVER_SIDE and (self.bottom >> dropped) - (self.top >> dropped) < _COVER_SIDE

    def _coarse(self, dropped: int) -> tuple[int, int, int, int, int]:
        """That many bits, and the window without them."""
        return dropped, self.west >> dropped, self.east >> dropped, self.top >> dropped, self.bottom >> dropped


@lru_cache(maxsize=_REMEMBERED_COVERS)
def _ranges(dropped: int, west: int, east: int, top: int, bottom: int) -> Ranges:
    """The cells of the tiles of `_codes`."""
    return merged(
        (code << 2 * dropped, ((code + 1) << 2 * dropped) - 1) for code in _codes(dropped, west, east, top, bottom)
    )


@lru_cache(maxsize=_REMEMBERED_COVERS)
def _remembered_codes(dropped: int, west: int, east: int, top: int, bottom: int) -> tuple[int, ...]:
    """The same as `_codes`, of at most 4 x 4 tiles."""
    return _codes(dropped, west, east, top, bottom)


def _codes(dropped: int, west: int, east: int, top: int, bottom: int) -> tuple[int, ...]:
    """Ascending Morton codes of all tiles whose columns and rows lack that many bits."""
    side = 1 << (CELL_ZOOM - dropped)
    rows = [_spread(row) << 1 for row in range(top, bottom + 1)]
    columns = range(west, min(east, west + side - 1) + 1)
    return tuple(sorted({_spread(column % side) | row for column in columns for row in rows}))


def window(centre: LatLon, radius_m: float) -> Window:
    """The window of a circle."""
    angle_rad = radius_m / LEAST_EARTH_RADIUS_M
    reach_deg = math.degrees(angle_rad)
    latitude_deg, longitude_deg = centre.latitude_deg, centre.longitude_deg
    top, bottom = _row(latitude_deg + reach_deg), _row(latitude_deg - reach_deg)
    half_width_deg = _half_width_deg(latitude_deg, angle_rad)
    if half_width_deg >= 180.0:
        return Window(0, _SIDE - 1, top, bottom)
    return Window(_column(longitude_deg - half_width_deg), _column(longitude_deg + half_width_deg), top, bottom)


def box_window(west_deg: float, south_deg: float, east_deg: float, north_deg: float) -> Window:
    """The window of a box of longitudes and latitudes; one with west > east runs across the antimeridian."""
    turn = _SIDE if west_deg > east_deg else 0
    return Window(
        _column(west_deg - _ROUNDING_DEG),
        _column(east_deg + _ROUNDING_DEG) + turn,
        _row(north_deg + _ROUNDING_DEG),
        _row(south_deg - _ROUNDING_DEG),
    )


def _half_width_deg(latitude_deg: float, angle_rad: float) -> float:
    """Half the range of longitudes of a cap, on a sphere of the least radius; the whole circle when it holds a pole."""
    latitude_rad = math.radians(latitude_deg)
    if abs(latitude_rad) + angle_rad >= math.pi / 2:
        return 180.0
    return math.degrees(math.asin(math.sin(angle_rad) / math.cos(latitude_rad)))


def _column(longitude_deg: float) -> int:
    """Column of cells, not wrapped."""
    return math.floor((longitude_deg + 180.0) / 360.0 * _SIDE)


def _row(latitude_deg: float) -> int:
    """Row of cells; the first and the last reach to the poles."""
    if latitude_deg >= MERCATOR_LATITUDE_DEG:
        return 0
    if latitude_deg <= -MERCATOR_LATITUDE_DEG:
        return _SIDE - 1
    row = math.floor((1 - math.asinh(math.tan(math.radians(latitude_deg))) / math.pi) / 2 * _SIDE)
    return max(0, min(_SIDE - 1, row))


@lru_cache(maxsize=_REMEMBERED)
def _spread(value: int) -> int:
    """Put a zero between the bits of a number below 2^32 (the usual magic masks)."""
    value = (value | value << 16) & 0x0000FFFF0000FFFF
    value = (value | value << 8) & 0x00FF00FF00FF00FF
    value = (value | value << 4) & 0x0F0F0F0F0F0F0F0F
    value = (value | value << 2) & 0x3333333333333333
    return (value | value << 1) & 0x5555555555555555
