"""The spatial key: Morton code of a web-mercator tile (a quadkey as a 64-bit integer).

At zoom 24 a tile is 2.4 m wide at the equator; its Morton code is an obstacle's `cell`. Every tile of a lower zoom is
one contiguous range of cells, so a circle is covered by a handful of ranges on one B-tree.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from contract.geometry import LatLon

Ranges = tuple[tuple[int, int], ...]

CELL_ZOOM = 24
TILE_ZOOM = 14
SHARD_ZOOM = 6

# The smallest radius of curvature of the WGS 84 ellipsoid (meridian, at the equator) makes every cover an outer one.
LEAST_EARTH_RADIUS_M = 6_335_439.0
MERCATOR_LATITUDE_DEG = 85.0511287798066
_COVER_SIDE = 4


def cell_of(position: LatLon) -> int:
    """Morton code of the position's tile at zoom 24."""
    return _morton(*_tile_xy(position.latitude_deg, position.longitude_deg, CELL_ZOOM))


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
    zoom = next(z for z in range(_finest_zoom(centre, radius_m), -1, -1) if _fits(centre, radius_m, z))
    shift = 2 * (CELL_ZOOM - zoom)
    return merged([(tile << shift, ((tile + 1) << shift) - 1) for tile in tiles(centre, radius_m, zoom)])


def tiles(centre: LatLon, radius_m: float, zoom: int = TILE_ZOOM) -> tuple[int, ...]:
    """Ascending Morton codes of the tiles of `zoom` that a circle touches."""
    columns, rows = _span(centre, radius_m, zoom)
    return tuple(sorted({_morton(x % (1 << zoom), y) for x in columns for y in rows}))


def merged(ranges: Iterable[tuple[int, int]]) -> Ranges:
    """The same cells as ascending ranges that neither overlap nor touch."""
    joined: list[tuple[int, int]] = []
    for low, high in sorted(ranges):
        if joined and low <= joined[-1][1] + 1:
            joined[-1] = (joined[-1][0], max(high, joined[-1][1]))
        else:
            joined.append((low, high))
    return tuple(joined)


def _finest_zoom(centre: LatLon, radius_m: float) -> int:
    """A zoom beyond which the circle is certainly wider than four tiles."""
    half_width_deg = _half_width_deg(centre.latitude_deg, radius_m / LEAST_EARTH_RADIUS_M)
    most_columns = _COVER_SIDE * 360.0 / (2 * max(half_width_deg, 1e-6))
    return max(0, min(CELL_ZOOM, math.floor(math.log2(most_columns))))


def _fits(centre: LatLon, radius_m: float, zoom: int) -> bool:
    columns, rows = _span(centre, radius_m, zoom)
    return len(columns) <= _COVER_SIDE and len(rows) <= _COVER_SIDE


def _span(centre: LatLon, radius_m: float, zoom: int) -> tuple[range, range]:
    """Columns (not yet wrapped) and rows of the tiles that a circle's bounding box touches."""
    angle_rad = radius_m / LEAST_EARTH_RADIUS_M
    south_deg = centre.latitude_deg - math.degrees(angle_rad)
    north_deg = centre.latitude_deg + math.degrees(angle_rad)
    _, top = _tile_xy(min(north_deg, 90.0), 0.0, zoom)
    _, bottom = _tile_xy(max(south_deg, -90.0), 0.0, zoom)
    half_width_deg = _half_width_deg(centre.latitude_deg, angle_rad)
    if half_width_deg >= 180.0:
        return range(1 << zoom), range(top, bottom + 1)
    west = _column(centre.longitude_deg - half_width_deg, zoom)
    east = _column(centre.longitude_deg + half_width_deg, zoom)
    return range(west, min(east, west + (1 << zoom) - 1) + 1), range(top, bottom + 1)


def _half_width_deg(latitude_deg: float, angle_rad: float) -> float:
    """Half the range of longitudes of a cap, on a sphere of the least radius; the whole circle when it holds a pole."""
    latitude_rad = math.radians(latitude_deg)
    if abs(latitude_rad) + angle_rad >= math.pi / 2:
        return 180.0
    return math.degrees(math.asin(math.sin(angle_rad) / math.cos(latitude_rad)))


def _tile_xy(latitude_deg: float, longitude_deg: float, zoom: int) -> tuple[int, int]:
    clamped_rad = math.radians(max(-MERCATOR_LATITUDE_DEG, min(MERCATOR_LATITUDE_DEG, latitude_deg)))
    row = (1 - math.asinh(math.tan(clamped_rad)) / math.pi) / 2 * (1 << zoom)
    last = (1 << zoom) - 1
    return _column(longitude_deg, zoom) % (1 << zoom), max(0, min(last, math.floor(row)))


def _column(longitude_deg: float, zoom: int) -> int:
    return math.floor((longitude_deg + 180.0) / 360.0 * (1 << zoom))


def _morton(x: int, y: int) -> int:
    return _spread(x) | _spread(y) << 1


def _spread(value: int) -> int:
    """Put a zero between the bits of a number below 2^32 (the usual magic masks)."""
    value = (value | value << 16) & 0x0000FFFF0000FFFF
    value = (value | value << 8) & 0x00FF00FF00FF00FF
    value = (value | value << 4) & 0x0F0F0F0F0F0F0F0F
    value = (value | value << 2) & 0x3333333333333333
    return (value | value << 1) & 0x5555555555555555
