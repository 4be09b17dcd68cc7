"""How a vehicle moves: a path through the street, the distance travelled on it, and a body that rocks on springs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from simulator.motion import rigid
from simulator.streets.centreline import SAMPLE_M, Centreline
from simulator.streets.road import Road

FloatArray = NDArray[np.float64]

WHEELBASE_M = 2.7

PAVEMENT_RISE_M = 0.02
"""Of the middle of a pavement above the top of its kerb, so that water runs off."""

NATURAL_FREQUENCIES_HZ = (1.3, 1.6)
"""Of a car's body in pitch and roll."""


class Path:
    """A line to drive along, in the order of driving, with the cross slope of the road below it."""

    def __init__(self, points_m: FloatArray, cross_slope: FloatArray) -> None:
        steps = np.hypot(*np.diff(points_m[:, :2], axis=0).T)
        distance = np.concatenate([[0.0], np.cumsum(steps)])
        self.line = Centreline(distance, points_m)
        self._cross_slope = CubicSpline(distance, cross_slope)

    def cross_slope(self, s_m: FloatArray) -> FloatArray:
        """Rise of the road to the left (N,) at distances along the path."""
        return np.asarray(self._cross_slope(s_m))


def lane_path(road: Road, lane: int) -> Path:
    """The middle of one lane in its direction, over the whole drawn road."""
    return path_beside(road, road.section.lane_offset_m(lane), road.section.lanes[lane])


def path_beside(road: Road, offset_m: float, direction: int, rise_m: float = 0.0) -> Path:
    """A line at a constant offset from the centreline, `rise_m` above the carriageway or its edge."""
    s = _along(road, direction)
    return _path(road, s, np.full_like(s, offset_m), direction, rise_m)


def pavement_path(road: Road, side: int, into_m: float, direction: int) -> Path:
    """A line on the pavement of one side (1 left, -1 right), so far from the carriageway's edge."""
    s = _along(road, direction)
    return _path(road, s, side * (road.half_width(s) + into_m), direction, road.section.kerb_height_m + PAVEMENT_RISE_M)


def _along(road: Road, direction: int) -> FloatArray:
    count = max(4, math.ceil(road.line.length_m / SAMPLE_M) + 1)
    return np.linspace(road.line.start_m, road.line.end_m, count)[::direction]


def _path(road: Road, s_m: FloatArray, t_m: FloatArray, direction: int, rise_m: float) -> Path:
    edge = road.half_width(s_m)
    inside = np.clip(t_m, -edge, edge)
    z = road.height(s_m, inside) + rise_m
    slope = np.where(np.abs(t_m) <= edge, direction * road.cross_slope(s_m, inside), 0.0)
    return Path(np.concatenate([road.line.plan(s_m, t_m), z[:, None]], axis=1), slope)


@dataclass(frozen=True, slots=True)
class Sway:
    """What keeps a body from following its path like a train: amplitudes, 1 sigma for the springs."""

    lateral_m: float = 0.08
    """Drivers weave about their line by a decimetre, over some fifty metres."""
    suspension_rad: float = math.radians(0.1)


STEADY = Sway(0.0, 0.0)


class Trajectory:
    """A `Motion` of the vehicle frame: x forward, on the road below the middle of the wheels.

    `distance_m` (K,) along the path at `time_s` (K,) is joined by a cubic spline; before and after it the vehicle goes
    on at constant speed.
    """

    def __init__(self, path: Path, time_s: FloatArray, distance_m: FloatArray, sway: Sway, seed: int) -> None:
        rng = np.random.default_rng([seed, 0])
        self._path, self._sway = path, sway
        self._distance = CubicSpline(time_s, distance_m)
        self._speed = self._distance.derivative()
        self._from_s, self._until_s = float(time_s[0]), float(time_s[-1])
        self._wave_per_m = 2 * math.pi / rng.uniform(40, 60)
        self._phase = rng.uniform(0, 2 * math.pi)
        self._rocking_phases = rng.uniform(0, 2 * math.pi, (2, 3))

    @property
    def path(self) -> Path:
        """What it follows."""
        return self._path

    def poses(self, time_s: FloatArray) -> FloatArray:
        """`street_from_vehicle` (N, 4, 4)."""
        s = self.distance(time_s)
        at, weave = self._path.line.at(s), self._weave(s)
        left = np.stack([-np.sin(at.heading_rad), np.cos(at.heading_rad)], axis=1)
        cross_slope = self._path.cross_slope(s)
        position = at.position_m.copy()
        position[:, :2] += left * weave[0][:, None]
        position[:, 2] += cross_slope * weave[0]
        pitch, roll = self._rocking(time_s)
        return rigid(
            position,
            at.heading_rad + np.arctan(weave[1]),
            pitch - np.arctan(at.grade),
            roll + np.arctan(cross_slope),
        )

    def distance(self, time_s: FloatArray) -> FloatArray:
        """Distance (N,) travelled on the path."""
        inside = np.clip(time_s, self._from_s, self._until_s)
        return np.asarray(self._distance(inside) + self._speed(inside) * (time_s - inside))

    def speed(self, time_s: FloatArray) -> FloatArray:
        """Speed (N,) in m/s."""
        return np.asarray(self._speed(np.clip(time_s, self._from_s, self._until_s)))

    def steering(self, time_s: FloatArray) -> FloatArray:
        """Angle (N,) of the front wheels, positive to the left, of a car of `WHEELBASE_M` without slip."""
        s = self.distance(time_s)
        return np.arctan(WHEELBASE_M * (self._path.line.at(s).curvature_per_m + self._weave(s)[2]))

    def _weave(self, s_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Offset to the left of the path and its first two derivatives by distance."""
        k, amplitude = self._wave_per_m, self._sway.lateral_m
        angle = k * s_m + self._phase
        return amplitude * np.sin(angle), amplitude * k * np.cos(angle), -amplitude * k**2 * np.sin(angle)

    def _rocking(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pitch and roll of unit deviation about the natural frequencies, scaled by the suspension's travel."""
        pitch, roll = (
            sum(
                (
                    np.sin(2 * math.pi * frequency * factor * time_s + phase)
                    for factor, phase in zip((0.7, 1.0, 1.37), phases, strict=True)
                ),
                np.zeros_like(time_s),
            )
            * math.sqrt(2 / 3)
            * self._sway.suspension_rad
            for frequency, phases in zip(NATURAL_FREQUENCIES_HZ, self._rocking_phases, strict=True)
        )
        return pitch, roll
