"""A box of latitudes and longitudes, and the cells that cover it. Pure."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

from server.geometry.quadkey import CELL_ZOOM, Ranges, merged

# More ranges narrow the box further but cost a look into the index each; a circle has at most as many.
_MOST_TILES = 16
# Rounding of the inverse projection: a few units in the last place of 180.
_ROUNDING_DEG = 1e-9

# As text: longitudes, latitudes and heights as plain decimals, for the API's description.
_LONGITUDE = r"-?(180(\.0+)?|(1[0-7][0-9]|[0-9]?[0-9])(\.[0-9]+)?)"
_LATITUDE = r"-?(90(\.0+)?|[0-8]?[0-9](\.[0-9]+)?)"
_HEIGHT = r"-?[0-9]{1,5}(\.[0-9]+)?"
_CORNER = f"{_LONGITUDE},{_LATITUDE}"
PATTERN = f"^{_CORNER},{_CORNER}$"
PATTERN_WITH_HEIGHTS = f"^({_CORNER},{_CORNER}|{_CORNER},{_HEIGHT},{_CORNER},{_HEIGHT})$"
_NUMBER = re.compile(r"-?[0-9]{1,5}(\.[0-9]{1,30})?")


@dataclass(frozen=True, slots=True)
class Bounds:
    """A box on WGS 84, edges included; `west_deg > east_deg` runs across the antimeridian (RFC 7946, 5.2).

    The heights are ellipsoidal metres, without end where they are infinite.
    """

    west_deg: float
    south_deg: float
    east_deg: float
    north_deg: float
    lowest_m: float = -math.inf
    highest_m: float = math.inf

    def __post_init__(self) -> None:
        """Refuse what is no box."""
        if not (-180 <= self.west_deg <= 180 and -180 <= self.east_deg <= 180):
            raise ValueError("bbox: longitudes lie within -180 and 180")
        if not -90 <= self.south_deg <= self.north_deg <= 90:
            raise ValueError("bbox: south must not exceed north, both within -90 and 90")
        if not self.lowest_m <= self.highest_m:
            raise ValueError("bbox: the lower height must not exceed the upper one")

    @classmethod
    def parsed(cls, text: str, *, with_heights: bool = False) -> Bounds:
        """From `west,south,east,north`, or the six numbers of a box with heights.

        Raises `ValueError` with what to write instead.
        """
        parts = text.split(",")
        if not all(map(_NUMBER.fullmatch, parts)) or len(parts) not in ((4, 6) if with_heights else (4,)):
            more = ", or west,south,lowest,east,north,highest" if with_heights else ""
            raise ValueError(f"bbox: write west,south,east,north in degrees{more}")
        numbers = [float(part) for part in parts]
        if len(numbers) == 4:
            return cls(*numbers)
        west, south, lowest, east, north, highest = numbers
        return cls(west, south, east, north, lowest, highest)

    @property
    def longitude_spans(self) -> tuple[tuple[float, float], ...]:
        """Closed spans of longitudes, west to east; the antimeridian belongs to both of its sides."""
        spans = [(self.west_deg, self.east_deg)]
        if self.west_deg > self.east_deg:
            spans = [(self.west_deg, 180.0), (-180.0, self.east_deg)]
        if any(east == 180.0 for _, east in spans):
            spans.append((-180.0, -180.0))
        if any(west == -180.0 for west, _ in spans):
            spans.append((180.0, 180.0))
        return tuple(spans)

    def cover(self) -> Ranges:
        """Ascending, disjoint, inclusive ranges of cells that hold every point of the box."""
        zoom, tiles = 0, [(0, 0, 0)]
        while zoom < CELL_ZOOM:
            finer = [child for tile in tiles for child in _children(*tile) if self._touches(zoom + 1, *child[1:])]
            if len(finer) > _MOST_TILES:
                break
            zoom, tiles = zoom + 1, finer
        shift = 2 * (CELL_ZOOM - zoom)
        return merged((code << shift, ((code + 1) << shift) - 1) for code, _, _ in tiles)

    def _touches(self, zoom: int, x: int, y: int) -> bool:
        south_deg, north_deg = _latitude_deg(y + 1, zoom), _latitude_deg(y, zoom)
        if self.south_deg > north_deg + _ROUNDING_DEG or self.north_deg < south_deg - _ROUNDING_DEG:
            return False
        west_deg, east_deg = (360.0 * column / (1 << zoom) - 180.0 for column in (x, x + 1))
        # The last floats below 180 degrees round into the first column.
        if x == 0 and any(east >= 180.0 - _ROUNDING_DEG for _, east in self.longitude_spans):
            return True
        return any(
            west <= east_deg + _ROUNDING_DEG and east >= west_deg - _ROUNDING_DEG for west, east in self.longitude_spans
        )


def _children(code: int, x: int, y: int) -> Iterator[tuple[int, int, int]]:
    """The four tiles of the next zoom: Morton code, column, row."""
    for down in (0, 1):
        for right in (0, 1):
            yield 4 * code + 2 * down + right, 2 * x + right, 2 * y + down


def _latitude_deg(row: int, zoom: int) -> float:
    """Latitude of a row's northern edge; the first and the last row reach to the poles."""
    if row == 0:
        return 90.0
    if row == 1 << zoom:
        return -90.0
    return math.degrees(math.atan(math.sinh(math.pi * (1 - 2 * row / (1 << zoom)))))
