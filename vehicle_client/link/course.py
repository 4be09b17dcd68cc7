"""Which way the car goes, from the places where it was. A pure fold."""

from __future__ import annotations

import math
from dataclasses import dataclass

from contract.geometry import LatLon
from vehicle_client.area import offset_m

LEAST_WAY_M = 30.0
"""Ten times the error of a consumer receiver: the direction is then good to six degrees."""


@dataclass(frozen=True, slots=True)
class Course:
    """Direction of the last metres driven, clockwise from north, in [0, 2 pi); None before there are any."""

    heading_rad: float | None = None
    since: LatLon | None = None

    def after(self, position: LatLon) -> Course:
        """The course with one more place."""
        if self.since is None:
            return Course(None, position)
        east_m, north_m = offset_m(self.since, position)
        if math.hypot(east_m, north_m) < LEAST_WAY_M:
            return self
        return Course(math.atan2(east_m, north_m) % (2 * math.pi), position)
