"""The way that lies ahead of the car, as its last moments let one expect it."""

from __future__ import annotations

import math
from typing import NamedTuple

from vehicle_client.frames import Vector

BEND_RAD = math.radians(45)
"""How far on a bend is expected to turn. Of a street's turn no more is known than that it began; a car that turns at a
junction would else be warned, quarter circle for quarter circle, of all that lies around it. Between 30 and 60 degrees
it makes no difference on the loops of `headsup evaluate warned`."""

CHANGES_WITHIN_M = 30.0
"""As long as a street takes to go over into a bend. Of a change that is under way nothing is known for farther on."""

HALF_LANE_M = 1.75
"""At a corner that a car takes within a second, all streets around would else be ahead."""

STRAIGHT_PER_M = 1e-6
"""A bend of 1,000 km."""


class Bend(NamedTuple):
    """Curvature of the way here (1/m, positive to the left), and the standard deviation of what it is ahead."""

    curvature_per_m: float = 0.0
    sd_per_m: float = 0.0

    def beside_sd_m(self, along_m: float) -> float:
        """How unsure that makes where the way is, across it, so far ahead: at most half a lane."""
        return min(self.sd_per_m * min(along_m, CHANGES_WITHIN_M) ** 2 / 2, HALF_LANE_M)


class OnWay(NamedTuple):
    """Where a place lies by a way: metres along it, not above 0 for what is behind, and metres to its left."""

    along_m: float
    left_m: float


def straight_on(place_m: Vector) -> OnWay:
    """A place (2,) or (3,) in the `vehicle` frame by the straight line ahead."""
    return OnWay(float(place_m[0]), float(place_m[1]))


def along_bend(place_m: Vector, curvature_per_m: float) -> OnWay:
    """The same by a circle (curvature in 1/m, positive to the left) up to `BEND_RAD`, and its tangent from there."""
    x, y = float(place_m[0]), float(place_m[1])
    if abs(curvature_per_m) < STRAIGHT_PER_M or x <= 0:
        return straight_on(place_m)
    side, radius_m = math.copysign(1.0, curvature_per_m), 1 / abs(curvature_per_m)
    inwards = side * y
    turned_rad = math.atan2(x, radius_m - inwards)
    if turned_rad <= BEND_RAD:
        return OnWay(turned_rad * radius_m, side * (radius_m - math.hypot(x, radius_m - inwards)))
    cos, sin = math.cos(BEND_RAD), math.sin(BEND_RAD)
    beyond, inside = x - radius_m * sin, inwards - radius_m * (1 - cos)
    return OnWay(radius_m * BEND_RAD + beyond * cos + inside * sin, side * (inside * cos - beyond * sin))


def on_way(place_m: Vector, curvature_per_m: float) -> OnWay:
    """The same by the bend or straight on, whichever passes nearer: bends begin and end."""
    return min(straight_on(place_m), along_bend(place_m, curvature_per_m), key=lambda way: abs(way.left_m))
