"""What a LiDAR receives of a surface: intensity and whether there is a return at all.

Two kinds with the same method, chosen by the sensor's preset: what CARLA computes, and the LiDAR equation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulator.scenery import Surface

if TYPE_CHECKING:
    from simulator.world import Hits, World

Float32Array = NDArray[np.float32]

DEFAULT_REFLECTIVITY = 0.3
REFLECTIVITY: dict[Surface, float] = {
    # Share of 905 nm light that a matt sample gives back: asphalt and concrete 0.1 to 0.4, leaves 0.4 to 0.6 in the
    # near infrared (ECOSTRESS spectral library, Meerdink et al. 2019); paint and glass are dark off their mirror angle.
    Surface.NOTHING: 0.0,
    Surface.ROAD: 0.20,
    Surface.KERB: 0.35,
    Surface.PAVEMENT: 0.30,
    Surface.GROUND: 0.40,
    Surface.WALL: 0.40,
    Surface.BUILDING: 0.45,
    Surface.ROOF: 0.35,
    Surface.CAR: 0.25,
    Surface.WHEEL: 0.06,
    Surface.TREE: 0.50,
    Surface.TRUNK: 0.30,
    Surface.POLE: 0.35,
    Surface.DEBRIS: 0.40,
    Surface.HILL: 0.45,
}


def reflectivity_table() -> Float32Array:
    """Reflectivity of every `Surface` value, (256,)."""
    table = np.full(256, DEFAULT_REFLECTIVITY, dtype=np.float32)
    table[list(REFLECTIVITY)] = list(REFLECTIVITY.values())
    return table


@dataclass(frozen=True, slots=True)
class CarlaReturns:
    """CARLA's ray-cast LiDAR: `ComputeIntensity` and `PostprocessDetection` of its RayCastLidar.cpp, version 0.9.16.

    Intensity is exp(-attenuation x distance), whatever was hit. `general_dropoff` of all rays are lost; of the returns
    with an intensity up to `dropoff_intensity_limit`, a share that rises linearly to `zero_intensity_dropoff`.
    The paper's preset loses nothing.
    """

    attenuation_per_m: float = 0.004
    general_dropoff: float = 0.0
    dropoff_intensity_limit: float = 0.8
    zero_intensity_dropoff: float = 0.0

    def __post_init__(self) -> None:
        shares = (self.general_dropoff, self.dropoff_intensity_limit, self.zero_intensity_dropoff)
        if not all(0.0 <= share <= 1.0 for share in shares) or not 0.0 <= self.attenuation_per_m < np.inf:
            raise ValueError("a LiDAR's drop-off rates and limit lie in [0, 1], its attenuation is not negative")

    def receive(
        self, range_m: Float32Array, power: Float32Array, chance: Float32Array
    ) -> tuple[Float32Array, NDArray[np.bool_]]:
        """Intensity (N,) and whether each ray returns, given a uniform draw `chance` (N,) for each."""
        intensity = np.exp(np.float32(-self.attenuation_per_m) * np.minimum(range_m, np.float32(1e6)))
        # One draw serves both steps: a ray that passed the first is uniform over what is left.
        weak_share = np.zeros_like(intensity)
        if self.zero_intensity_dropoff > 0:
            limit = max(self.dropoff_intensity_limit, 1e-6)
            weak_share = np.where(
                intensity > self.dropoff_intensity_limit,
                np.float32(0.0),
                np.float32(self.zero_intensity_dropoff) * (1 - intensity / np.float32(limit)),
            )
        kept = chance < np.float32(1.0 - self.general_dropoff) * (1 - weak_share)
        return intensity, kept


@dataclass(frozen=True, slots=True)
class MeasuredReturns:
    """A real sensor: received power by the LiDAR equation of an extended matt target, and a threshold with noise.

    power = reflectivity x cos(incidence) / range^2 (Winiwarter et al., HELIOS++, 2022, eq. 3 without the sensor's
    constants). A target of reflectivity 0.1 seen squarely at `reach_m` returns half of the time, others with
    P^k / (P^k + P_half^k), k = `steepness`. Intensity is what the maker calibrates to: power x range^2, times `gain`.
    """

    reach_m: float
    steepness: float
    gain: float = 1.0

    def __post_init__(self) -> None:
        if not all(0.0 < value < np.inf for value in (self.reach_m, self.steepness, self.gain)):
            raise ValueError("a LiDAR's reach, steepness and gain are positive")

    def receive(
        self, range_m: Float32Array, power: Float32Array, chance: Float32Array
    ) -> tuple[Float32Array, NDArray[np.bool_]]:
        """Intensity (N,) and whether each ray returns, given a uniform draw `chance` (N,) for each."""
        squared = range_m * range_m
        with np.errstate(invalid="ignore", divide="ignore"):
            relative = power * np.float32(self.reach_m**2 / 0.1)
            kept = chance * (1 + relative ** np.float32(-self.steepness)) < 1
            intensity = np.clip(np.float32(self.gain) * power * squared, 0, 1)
        return intensity, kept


Returns = CarlaReturns | MeasuredReturns


def received_power(world: World, hits: Hits, rays: Float32Array) -> Float32Array:
    """Power (N,) that comes back along unit rays (N, 3), without the sensor's constants; 0 where nothing was hit."""
    reflectivity = reflectivity_table()[world.surfaces(hits)]
    power: Float32Array = _power(hits.distance, hits.normal, rays, reflectivity)
    return power


@njit(cache=True, nogil=True)
def cos_incidence(normal: Float32Array, rays: Float32Array) -> Float32Array:
    """Cosine (N,) of the angle between unit normals (N, 3), of either side, and unit rays (N, 3)."""
    cosine = np.empty(len(rays), dtype=np.float32)
    for i in range(len(rays)):
        dot = rays[i, 0] * normal[i, 0] + rays[i, 1] * normal[i, 1] + rays[i, 2] * normal[i, 2]
        cosine[i] = min(abs(dot), np.float32(1.0))
    return cosine


@njit(cache=True, nogil=True)
def _power(
    distance: Float32Array, normal: Float32Array, rays: Float32Array, reflectivity: Float32Array
) -> Float32Array:
    power = np.zeros(len(rays), dtype=np.float32)
    for i in range(len(rays)):
        if np.isfinite(distance[i]) and distance[i] > 0:
            dot = rays[i, 0] * normal[i, 0] + rays[i, 1] * normal[i, 1] + rays[i, 2] * normal[i, 2]
            power[i] = reflectivity[i] * abs(dot) / (distance[i] * distance[i])
    return power
