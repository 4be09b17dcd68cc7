"""Cars that follow each other: the Intelligent Driver Model along a path, with speeds that its curves allow."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.streets.trajectory import Path

FloatArray = NDArray[np.float64]

STEP_S = 0.1
"""Far below the reaction times that the model describes."""

# Treiber, Hennecke and Helbing 2000, Congested traffic states, table I; the headway is that of calm drivers in towns.
HEADWAY_S, STANDSTILL_GAP_M, ACCELERATION_MPS2, BRAKING_MPS2 = 1.5, 2.0, 1.2, 1.8
CAR_LENGTH_M = 4.3

LATERAL_MPS2, EASY_BRAKING_MPS2 = 2.0, 1.2
"""What passengers find comfortable in a curve and before it; half of what they bear."""

FORESIGHT_S = 1.5
"""Drivers go by the speed that the road will allow so much later: the model alone brakes only once it is too fast."""


@dataclass(frozen=True, slots=True)
class Driver:
    """A car in a lane: where its origin is at time 0, and its wish as a share of the limit."""

    start_m: float
    eagerness: float = 1.0


def speed_limits(path: Path, limit_mps: float) -> tuple[FloatArray, FloatArray]:
    """Distances (K,) along a path and the greatest speed (K,) there: by sign, by curve, and early enough to brake."""
    s = np.arange(path.line.start_m, path.line.end_m, 2.0)
    curvature = np.abs(path.line.at(s).curvature_per_m)
    speed = np.minimum(limit_mps, np.sqrt(LATERAL_MPS2 / np.maximum(curvature, 1e-6)))
    for i in range(len(s) - 2, -1, -1):
        speed[i] = min(speed[i], math.sqrt(speed[i + 1] ** 2 + 2 * EASY_BRAKING_MPS2 * (s[i + 1] - s[i])))
    return s, speed


def follow(path: Path, drivers: Sequence[Driver], limit_mps: float, duration_s: float) -> tuple[FloatArray, FloatArray]:
    """Times (K,) and distances (K, drivers) of cars in one lane, each behind the one that starts next ahead of it.

    Raises ValueError where two cars start closer than a standstill allows.
    """
    along, allowed = speed_limits(path, limit_mps)
    position = np.array([driver.start_m for driver in drivers], dtype=np.float64)
    eagerness = np.array([driver.eagerness for driver in drivers])
    order = np.argsort(-position)
    gaps = -np.diff(position[order]) - CAR_LENGTH_M
    if (gaps < STANDSTILL_GAP_M).any():
        raise ValueError(f"cars of one lane start at least {CAR_LENGTH_M + STANDSTILL_GAP_M:.1f} m apart")
    speed = np.empty_like(position)
    speed[order] = _first_speeds((np.interp(position, along, allowed) * eagerness)[order], gaps)
    # Nobody starts faster than the headway to the car ahead allows.
    speed[order[1:]] = np.minimum(speed[order[1:]], (gaps - STANDSTILL_GAP_M) / HEADWAY_S)
    times = np.asarray(np.arange(math.ceil(duration_s / STEP_S) + 2) * STEP_S, dtype=np.float64)
    travelled = np.empty((len(times), len(drivers)))
    for row in range(len(times)):
        travelled[row] = position
        ahead = np.minimum(*(np.interp(p, along, allowed) for p in (position, position + speed * FORESIGHT_S)))
        wished = ahead * eagerness
        acceleration = _acceleration(position[order], speed[order], wished[order])
        # Semi-implicit: the new speed moves the car, and never backwards.
        speed[order] = np.maximum(speed[order] + acceleration * STEP_S, 0.0)
        position = position + speed * STEP_S
    return times, travelled


def _first_speeds(wished: FloatArray, gaps_m: FloatArray) -> FloatArray:
    """Speeds in the order of driving from which each car can brake behind the one ahead without hurry."""
    speed = wished.copy()
    for i, gap in enumerate(gaps_m, start=1):
        speed[i] = min(speed[i], math.sqrt(speed[i - 1] ** 2 + 2 * BRAKING_MPS2 * (gap - STANDSTILL_GAP_M)))
    return speed


def _acceleration(position: FloatArray, speed: FloatArray, wished: FloatArray) -> FloatArray:
    """The model's acceleration of cars in the order of driving; the first one drives freely."""
    free = 1 - (speed / np.maximum(wished, 0.1)) ** 4
    gap = np.concatenate([[np.inf], np.maximum(-np.diff(position) - CAR_LENGTH_M, 0.1)])
    closing = np.concatenate([[0.0], np.diff(speed)])
    desired = STANDSTILL_GAP_M + np.maximum(
        speed * HEADWAY_S + speed * closing / (2 * math.sqrt(ACCELERATION_MPS2 * BRAKING_MPS2)), 0
    )
    # Beyond -8 m/s^2 a dry road gives no grip.
    return np.asarray(np.maximum(ACCELERATION_MPS2 * (free - (desired / gap) ** 2), -8.0))
