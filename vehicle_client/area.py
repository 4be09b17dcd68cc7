"""Which part of the world a message of the server speaks of. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from contract.events import Appeared, Left, Removed, Updated
from contract.geometry import LatLon
from contract.obstacle import ObstacleFeature

EDGE_M = 1.0
"""So close to its edge it is open whether the server counted a place as inside."""

_EQUATOR_M, _FLATTENING = 6_378_137.0, 1 / 298.257223563  # WGS 84

_LEAST_DEGREE_M = 110_574.0  # of latitude, at the equator


def offset_m(origin: LatLon, position: LatLon) -> tuple[float, float]:
    """East and north of a position in metres, by the ellipsoid's radii of curvature: to a metre within 5 km."""
    middle_rad = math.radians((origin.latitude_deg + position.latitude_deg) / 2)
    eccentricity2 = _FLATTENING * (2 - _FLATTENING)
    w2 = 1 - eccentricity2 * math.sin(middle_rad) ** 2
    prime_vertical_m = _EQUATOR_M / math.sqrt(w2)
    meridional_m = prime_vertical_m * (1 - eccentricity2) / w2
    # The short way round, also across the antimeridian.
    turn_deg = math.remainder(position.longitude_deg - origin.longitude_deg, 360)
    east_m = math.radians(turn_deg) * prime_vertical_m * math.cos(middle_rad)
    return east_m, math.radians(position.latitude_deg - origin.latitude_deg) * meridional_m


def distance_m(a: LatLon, b: LatLon) -> float:
    """Distance of two positions, as `offset_m`."""
    return math.hypot(*offset_m(a, b))


@dataclass(frozen=True, slots=True)
class Strip:
    """The strip of full width `width_m` that begins at a place and runs along a heading, clockwise from north."""

    heading_rad: float
    width_m: float


@dataclass(frozen=True, slots=True)
class Area:
    """A circle; with `ahead` only that strip of it."""

    centre: LatLon
    radius_m: float
    ahead: Strip | None = None

    def surely_holds(self, position: LatLon) -> bool:
        """Whether a position lies inside, and not at the edge."""
        # Most of a map lies far to the north or south: nothing need be computed.
        if abs(position.latitude_deg - self.centre.latitude_deg) * _LEAST_DEGREE_M > self.radius_m:
            return False
        east_m, north_m = offset_m(self.centre, position)
        if math.hypot(east_m, north_m) > self.radius_m - EDGE_M:
            return False
        if self.ahead is None:
            return True
        sin, cos = math.sin(self.ahead.heading_rad), math.cos(self.ahead.heading_rad)
        along_m, across_m = east_m * sin + north_m * cos, east_m * cos - north_m * sin
        return along_m > EDGE_M and abs(across_m) < self.ahead.width_m / 2 - EDGE_M


@dataclass(frozen=True, slots=True)
class Surveyed:
    """The server has said all that there is in an area: what is not among it does not lie there."""

    area: Area
    obstacles: tuple[ObstacleFeature, ...]


@dataclass(frozen=True, slots=True)
class Reached:
    """The server watches this area now, and has said what came into it: it holds nothing else."""

    area: Area


Heard = Surveyed | Reached | Appeared | Updated | Removed | Left
"""What the car hears of the server, by push or by polling."""
