"""Height of the car above the ellipsoid: odometry's climb, corrected by satellite altitudes, with its variance."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from vehicle_client.frames import Matrix, Vector

MEMORY_S = 100.0
"""Altitudes err like places, longer than a minute: atmosphere and orbits (Rankin, IEEE PLANS 1994)."""

SLOW, WHITE = 0.95, 0.31
"""Shares of the stated deviation; their squares make one. No model is chosen for a height: warnings hardly need it."""

GRADE_SD = 0.05
"""Roads are built up to 5 to 12 %, and dead reckoning knows no grade at all."""

GRADE_LASTS_M = 200.0
"""Grades change over hundreds of metres."""

WAY_SD_M = 0.03
"""Noise after a metre, growing with the root of the way."""

GATE_SD = 4.0


@dataclass(frozen=True, slots=True)
class HeightFilter:
    """Mean (3,) and covariance (3, 3) of: height above the origin, grade that odometry misses, slow error in units."""

    mean: Vector
    covariance: Matrix

    @property
    def height_m(self) -> float:
        """Height over the origin."""
        return float(self.mean[0])

    @property
    def sd_m(self) -> float:
        """Its standard deviation."""
        return math.sqrt(float(self.covariance[0, 0]))


def started(height_m: float, sd_m: float) -> HeightFilter:
    """A filter at one altitude, whose error is that altitude's."""
    covariance = np.diag([sd_m**2, GRADE_SD**2, 1.0])
    covariance[0, 2] = covariance[2, 0] = -sd_m * SLOW
    return HeightFilter(np.array([height_m, 0.0, 0.0]), covariance)


def advanced(height: HeightFilter, climb_m: float, way_m: float, elapsed_s: float) -> HeightFilter:
    """After a way that odometry says climbed so far."""
    kept, grade_kept = math.exp(-elapsed_s / MEMORY_S), math.exp(-way_m / GRADE_LASTS_M)
    jacobian = np.array([[1.0, way_m, 0.0], [0.0, grade_kept, 0.0], [0.0, 0.0, kept]])
    noise = np.diag([WAY_SD_M**2 * way_m, GRADE_SD**2 * (1 - grade_kept**2), 1 - kept**2])
    mean = jacobian @ height.mean + np.array([climb_m, 0.0, 0.0])
    return HeightFilter(mean, jacobian @ height.covariance @ jacobian.T + noise)


def with_altitude(height: HeightFilter, height_m: float, sd_m: float) -> HeightFilter:
    """After a measured height over the origin; one that cannot be is left out."""
    jacobian = np.array([1.0, 0.0, sd_m * SLOW])
    variance = float(jacobian @ height.covariance @ jacobian) + (sd_m * WHITE) ** 2
    residual = height_m - float(jacobian @ height.mean)
    if residual**2 > GATE_SD**2 * variance:
        return height
    gain = height.covariance @ jacobian / variance
    rest = np.eye(3) - np.outer(gain, jacobian)
    covariance = rest @ height.covariance @ rest.T + np.outer(gain, gain) * (sd_m * WHITE) ** 2
    return replace(height, mean=height.mean + gain * residual, covariance=covariance)
