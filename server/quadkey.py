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
_COVER_SIDE = 4
# Columns and rows of tiles, whose bits are spread on the way of every query.
_REMEMBERED = 1 << 15


def cell_of(position: LatLon) -> int:
    """Morton code of the position's tile at zoom 24."""
    column = math.floor(_across(position.longitude_deg) * (1 << CELL_ZOOM)) % (1 << CELL_ZOOM)
    return _spread(column) | _spread(_row(_down(position.latitude_deg), CELL_ZOOM)) << 1


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
    window = _window(centre, radius_m)
    zoom = next(z for z in range(window.finest_zoom(), -1, -1) if window.fits(z))
    shift = 2 * (CELL_ZOOM - zoom)
    return merged([(tile << shift, ((tile + 1) << shift) - 1) for tile in window.tiles(zoom)])


def tiles(centre: LatLon, radius_m: float, zoom: int = TILE_ZOOM) -> tuple[int, ...]:
    """Ascending Morton codes of the tiles of `zoom` that a circle touches."""
    return _window(centre, radius_m).tiles(zoom)


def merged(ranges: Iterable[tuple[int, int]]) -> Ranges:
    """The same cells as ascending ranges that neither overlap nor touch."""
    joined: list[tuple[int, int]] = []
    for low, high in sorted(ranges):
        if joined and low <= joined[-1][1] + 1:
            joined[-1] = (joined[-1][0], max(high, joined[-1][1]))
        else:
            joined.append((low, high))
    return tuple(joined)


class _Window(NamedTuple):
    """A circle's bounding box in parts of the mercator square: x from the antimeridian (unwrapped), y from the top.

    Sides of tiles are powers of two, so that scaling to any zoom is exact.
    """

    west: float
    east: float
    top: float
    bottom: float

    def finest_zoom(self) -> int:
        """A zoom beyond which the window is certainly wider than a cover."""
        most_columns = _COVER_SIDE / max(self.east - self.west, 1e-9)
        return max(0, min(CELL_ZOOM, math.floor(math.log2(most_columns))))

    def fits(self, zoom: int) -> bool:
        """Whether a cover of that zoom is small enough."""
        return len(self._columns(zoom)) <= _COVER_SIDE and len(self._rows(zoom)) <= _COVER_SIDE

    def tiles(self, zoom: int) -> tuple[int, ...]:
        """Ascending Morton codes of the tiles that the window touches."""
        side = 1 << zoom
        columns, rows = self._columns(zoom), self._rows(zoom)
        if len(columns) == len(rows) == 1:
            return (_spread(columns[0] % side) | _spread(rows[0]) << 1,)
        xs = [_spread(x % side) for x in columns]
        ys = [_spread(y) << 1 for y in rows]
        return tuple(sorted({x | y for x in xs for y in ys}))

    def _columns(self, zoom: int) -> range:
        west, east = math.floor(self.west * (1 << zoom)), math.floor(self.east * (1 << zoom))
        return range(west, min(east, west + (1 << zoom) - 1) + 1)

    def _rows(self, zoom: int) -> range:
        return range(_row(self.top, zoom), _row(self.bottom, zoom) + 1)


def _window(centre: LatLon, radius_m: float) -> _Window:
    angle_rad = radius_m / LEAST_EARTH_RADIUS_M
    south_deg = centre.latitude_deg - math.degrees(angle_rad)
    north_deg = centre.latitude_deg + math.degrees(angle_rad)
    top, bottom = _down(min(north_deg, 90.0)), _down(max(south_deg, -90.0))
    half_width_deg = _half_width_deg(centre.latitude_deg, angle_rad)
    if half_width_deg >= 180.0:
        return _Window(0.0, math.nextafter(1.0, 0.0), top, bottom)
    longitude_deg = centre.longitude_deg
    return _Window(_across(longitude_deg - half_width_deg), _across(longitude_deg + half_width_deg), top, bottom)


def _half_width_deg(latitude_deg: float, angle_rad: float) -> float:
    """Half the range of longitudes of a cap, on a sphere of the least radius; the whole circle when it holds a pole."""
    latitude_rad = math.radians(latitude_deg)
    if abs(latitude_rad) + angle_rad >= math.pi / 2:
        return 180.0
    return math.degrees(math.asin(math.sin(angle_rad) / math.cos(latitude_rad)))


def _across(longitude_deg: float) -> float:
    return (longitude_deg + 180.0) / 360.0


def _down(latitude_deg: float) -> float:
    if abs(latitude_deg) > MERCATOR_LATITUDE_DEG:
        latitude_deg = math.copysign(MERCATOR_LATITUDE_DEG, latitude_deg)
    return (1 - math.asinh(math.tan(math.radians(latitude_deg))) / math.pi) / 2


def _row(down: float, zoom: int) -> int:
    return max(0, min((1 << zoom) - 1, math.floor(down * (1 << zoom))))


@lru_cache(maxsize=_REMEMBERED)
def _spread(value: int) -> int:
    """Put a zero between the bits of a number below 2^32 (the usual magic masks)."""
    value = (value | value << 16) & 0x0000FFFF0000FFFF
    value = (value | value << 8) & 0x00FF00FF00FF00FF
    value = (value | value << 4) & 0x0F0F0F0F0F0F0F0F
    value = (value | value << 2) & 0x3333333333333333
    return (value | value << 1) & 0x5555555555555555
