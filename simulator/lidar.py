"""A rotating multi-channel LiDAR: which rays it sends, and what it measures of their hits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from simulator.world import World

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LidarModel:
    """Default: the paper's sensor (section "Experimental Setup"), CARLA's ray-cast LiDAR with 64 channels."""

    channels: int = 64
    upper_elevation_rad: float = math.radians(10.0)
    lower_elevation_rad: float = math.radians(-30.0)
    range_m: float = 100.0
    points_per_second: int = 800_000
    rate_hz: float = 30.0
    height_m: float = 2.4
    range_sd_m: float = 0.01

    @property
    def columns(self) -> int:
        """Directions of azimuth in one turn."""
        return int(self.points_per_second / self.rate_hz / self.channels)

    @property
    def elevations_rad(self) -> FloatArray:
        """Elevation of each ring, (channels,); ring 0 looks down most."""
        return np.linspace(self.lower_elevation_rad, self.upper_elevation_rad, self.channels)


@dataclass(frozen=True, slots=True)
class Sweep:
    """One turn: the returns in the order they were fired (by azimuth, then ring), and the truth of each.

    `points_m` (N, 3) float32, frame `sensor`; `ring` (N,); `azimuth_rad` (N,) counter-clockwise from ahead;
    `surface` (N,) holds `Surface` values, `obstacle_id` (N,) the obstacle's number or 0.
    """

    points_m: NDArray[np.float32]
    ring: NDArray[np.uint16]
    azimuth_rad: NDArray[np.float32]
    surface: NDArray[np.uint8]
    obstacle_id: NDArray[np.int32]


def directions(lidar: LidarModel, phase_rad: float) -> tuple[FloatArray, FloatArray, NDArray[np.uint16]]:
    """Unit directions (N, 3) of one turn, with their azimuths (N,) and rings (N,)."""
    azimuths = phase_rad + np.arange(lidar.columns) * (2 * math.pi / lidar.columns)
    azimuth, elevation = (a.ravel() for a in np.meshgrid(azimuths, lidar.elevations_rad, indexing="ij"))
    ring = np.tile(np.arange(lidar.channels, dtype=np.uint16), lidar.columns)
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1), azimuth, ring


def measure(world: World, lidar: LidarModel, street_from_sensor: FloatArray, rng: np.random.Generator) -> Sweep:
    """One turn with its own azimuth phase and range noise along the rays; misses are left out."""
    rays, azimuth, ring = directions(lidar, rng.uniform(0, 2 * math.pi / lidar.columns))
    noise_m = rng.normal(0.0, lidar.range_sd_m, len(rays))
    origin = street_from_sensor[:3, 3]
    street_rays = rays @ street_from_sensor[:3, :3].T
    hits = world.cast(origin.astype(np.float32), street_rays.astype(np.float32))
    range_m = hits.distance.astype(np.float64)
    returned = range_m <= lidar.range_m
    hit_m = origin + street_rays * np.where(returned, range_m, 0.0)[:, None]
    ids = world.obstacle_ids(hits, hit_m)
    points = rays[returned] * (range_m + noise_m)[returned, None]
    return Sweep(
        points_m=points.astype(np.float32),
        ring=ring[returned],
        azimuth_rad=azimuth[returned].astype(np.float32),
        surface=world.surfaces(hits)[returned],
        obstacle_id=ids[returned],
    )
