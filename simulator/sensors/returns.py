"""What a LiDAR receives of a surface: intensity and whether there is a return at all.

Two kinds with the same method, chosen by the sensor's preset: what CARLA computes, and the LiDAR equation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulator.scene.scenery import Surface

if TYPE_CHECKING:
    from simulator.world import Hits

Float32Array = NDArray[np.float32]

ROUGHNESS_RAD = 0.5
"""Spread of the slopes of a surface's facets: with it, a road is as bright at 20 m as at 5 m, as in real scans."""

MATT_SHARE = 1 - 0.5 * ROUGHNESS_RAD**2 / (ROUGHNESS_RAD**2 + 0.33)
ROUGH_SHARE = 0.45 * ROUGHNESS_RAD**2 / (ROUGHNESS_RAD**2 + 0.09)

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
    Surface.PEDESTRIAN: 0.35,
    # A level puddle mirrors the beam away; what comes back is mud through the water and its ripples.
    Surface.WATER: 0.001,
    Surface.MANHOLE: 0.12,
    Surface.ROAD_MARK: 0.60,
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
        self, range_m: Float32Array, power: Float32Array, rng: np.random.Generator
    ) -> tuple[Float32Array, NDArray[np.bool_]]:
        """Intensity (N,) and whether each ray returns; range inf is a ray that hit nothing."""
        intensity = np.exp(np.float32(-self.attenuation_per_m) * np.minimum(range_m, np.float32(1e6)))
        kept = rng.random(len(range_m), dtype=np.float32) >= self.general_dropoff
        if self.zero_intensity_dropoff > 0:
            slope = self.zero_intensity_dropoff / max(self.dropoff_intensity_limit, 1e-6)
            chance = np.float32(1 - self.zero_intensity_dropoff) + np.float32(slope) * intensity
            kept &= (intensity > self.dropoff_intensity_limit) | (rng.random(len(range_m), dtype=np.float32) < chance)
        return intensity, kept


@dataclass(frozen=True, slots=True)
class MeasuredReturns:
    """A real sensor: what comes back of a rough target that fills the beam, and the least power that it notices.

    The power is that of `received_power`, times a log-normal factor for texture and speckle with the standard deviation
    `fluctuation` of its logarithm. A target of reflectivity 0.1 seen squarely at `reach_m` is noticed half of the time.
    Intensity is what the maker calibrates to: power x range^2, the target's apparent reflectivity, times `gain`.
    """

    reach_m: float
    fluctuation: float
    gain: float

    def __post_init__(self) -> None:
        if not all(0.0 < value < np.inf for value in (self.reach_m, self.fluctuation, self.gain)):
            raise ValueError("a LiDAR's reach, fluctuation and gain are positive")

    def receive(
        self, range_m: Float32Array, power: Float32Array, rng: np.random.Generator
    ) -> tuple[Float32Array, NDArray[np.bool_]]:
        """Intensity (N,) and whether each ray returns; range inf is a ray that hit nothing."""
        received = power * np.exp(rng.standard_normal(len(power), dtype=np.float32) * np.float32(self.fluctuation))
        kept = received > 0.1 / self.reach_m**2
        squared = np.square(np.where(kept, range_m, np.float32(0.0)))
        return np.minimum(np.float32(self.gain) * received * squared, np.float32(1.0)), kept


Returns = CarlaReturns | MeasuredReturns


def received_power(hits: Hits, rays: Float32Array, surface: NDArray[np.uint8]) -> Float32Array:
    """Power (N,) that comes back along unit rays (N, 3) from `Surface` values (N,); 0 where nothing was hit.

    Without the sensor's constants.

    Power = reflectivity x shape / range^2, the LiDAR equation of a target that fills the beam (Winiwarter et al.,
    Virtual laser scanning with HELIOS++, Remote Sensing of Environment 269, 2022). Its shape is that of Oren and Nayar
    (Generalization of Lambert's reflectance model, SIGGRAPH 1994, qualitative model) where light comes from: with
    incidence t, A cos t + B sin^2 t. A matt plane would darken towards the horizon; real roads do not.
    """
    power: Float32Array = _power(hits.distance, hits.normal, rays, reflectivity_table()[surface])
    return power


@njit(cache=True, nogil=True)
def _power(
    distance: Float32Array, normal: Float32Array, rays: Float32Array, reflectivity: Float32Array
) -> Float32Array:
    power = np.zeros(len(rays), dtype=np.float32)
    for i in range(len(rays)):
        if np.isfinite(distance[i]) and distance[i] > 0:
            dot = rays[i, 0] * normal[i, 0] + rays[i, 1] * normal[i, 1] + rays[i, 2] * normal[i, 2]
            cosine = min(abs(dot), np.float32(1.0))
            shape = MATT_SHARE * cosine + ROUGH_SHARE * (1 - cosine * cosine)
            power[i] = reflectivity[i] * shape / (distance[i] * distance[i])
    return power
