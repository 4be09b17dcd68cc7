"""A box of latitudes and longitudes, and the cells that cover it. Pure."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from server.geometry.quadkey import Ranges, box_window

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

    def holds(self, latitude_deg: float, longitude_deg: float) -> bool:
        """Whether a place lies in the box, whatever its height."""
        return self.south_deg <= latitude_deg <= self.north_deg and any(
            west <= longitude_deg <= east for west, east in self.longitude_spans
        )

    def cover(self) -> Ranges:
        """Ascending, disjoint, inclusive ranges of cells that hold every point of the box."""
        return box_window(self.west_deg, self.south_deg, self.east_deg, self.north_deg).cover()
