"""A street and the ways through it, drawn from a seed or read from a map: what a scenario is played on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simulator.streets.road import Road
from simulator.streets.street import Street
from simulator.streets.traffic import speed_limits
from simulator.streets.trajectory import Path

SPEED_LIMIT_MPS = 50 / 3.6

MOST_EAGER = 1.05
"""No driver wishes for more than this share of the limit."""

BEHIND_M = 10.0
"""The last ego starts this far into the way that is driven."""


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """A part of a road that is driven and looked at closely."""

    road: Road
    from_m: float
    to_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """A street, and the lanes through it that traffic follows; the first lane is that of the egos.

    Egos start at `from_m` of their lane or later; `stretches` are the roads that people walk and cars park along.
    """

    street: Street
    lanes: tuple[Path, ...]
    from_m: float
    stretches: tuple[Stretch, ...]


def last_start_m(path: Path, duration_s: float) -> float:
    """From where on a path even the most eager driver stays on it for so long; negative if there is no such place."""
    along, allowed = speed_limits(path, SPEED_LIMIT_MPS)
    speed = allowed * MOST_EAGER
    steps_s = np.diff(along) / np.minimum(speed[:-1], speed[1:])
    left_s = np.concatenate([np.cumsum(steps_s[::-1])[::-1], [0.0]])
    return float(np.interp(-duration_s, -left_s, along)) if left_s[0] >= duration_s else -1.0


def driving_time_s(path: Path, from_m: float) -> float:
    """Seconds that the most eager driver takes from a place on a path to its end."""
    along, allowed = speed_limits(path, SPEED_LIMIT_MPS)
    rest = np.linspace(from_m, along[-1], 200)
    return float(np.trapezoid(1 / (MOST_EAGER * np.interp(rest, along, allowed)), rest)) if from_m < along[-1] else 0.0
