"""How far points of the road ahead lie off its surface, and which of them by more than noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from detector.arrays import FloatArray

# Deviation that flags a point, but not the texture of asphalt and patches; what is noise is told by the cluster.
FLAG_SD = 2.5
MIN_DEPTH_M = 0.02
MIN_HEIGHT_M = 0.025
# Deeper is no pothole but a reflection below the road; higher is an overhang.
MAX_DEPTH_M = 0.5
OVERHANG_M = 2.5


@dataclass(frozen=True, slots=True)
class Deviations:
    """Points of the corridor: coordinates along and across its path, signed residual to the surface and its noise,
    each (N,), in metres, and the sensor's height over the road."""

    along_m: FloatArray
    across_m: FloatArray
    range_m: FloatArray
    residual_m: FloatArray
    noise_m: FloatArray
    sensor_height_m: float

    @property
    def level_range_m(self) -> FloatArray:
        """Range (N,) at which each point's ray crosses the road's level: one value a ring, in a hole or beside it."""
        return np.asarray(_level_range(self.range_m, self.residual_m, self.sensor_height_m))

    @property
    def below(self) -> np.ndarray:
        """Mask of points below the road by more than noise."""
        return np.asarray(_beyond_noise(self.residual_m, self.noise_m, -1.0, MIN_DEPTH_M, MAX_DEPTH_M))

    @property
    def above(self) -> np.ndarray:
        """Mask of points above the road by more than noise."""
        return np.asarray(_beyond_noise(self.residual_m, self.noise_m, 1.0, MIN_HEIGHT_M, OVERHANG_M))


@njit(cache=True, nogil=True)
def _level_range(range_m: FloatArray, residual: FloatArray, sensor_height: float) -> FloatArray:
    level = np.empty(len(range_m))
    for i in range(len(range_m)):
        level[i] = range_m[i] * sensor_height / max(sensor_height - residual[i], MIN_HEIGHT_M)
    return level


@njit(cache=True, nogil=True)
def _beyond_noise(residual: FloatArray, noise: FloatArray, sign: float, least: float, most: float) -> np.ndarray:
    """Mask (N,) of residuals of a sign that are greater than noise and than `least`, but less than `most`."""
    beyond = np.empty(len(residual), dtype=np.bool_)
    for i in range(len(residual)):
        beyond[i] = max(FLAG_SD * noise[i], least) < sign * residual[i] < most
    return beyond
