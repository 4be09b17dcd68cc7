"""A rotating multi-channel LiDAR: which rays it sends, and what it measures of their hits."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulator.motion import Motion
from simulator.readings import Sweep
from simulator.sensors.beam import Beam, Shots, spread
from simulator.sensors.returns import CarlaReturns, Returns, received_power

if TYPE_CHECKING:
    from simulator.world import Hits, World

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Laser:
    """One channel: its elevation, where it looks out above the sensor's origin, and what it adds to every range."""

    elevation_rad: float
    height_m: float = 0.0
    range_bias_m: float = 0.0


@dataclass(frozen=True, slots=True)
class LidarModel:
    """Default: the paper's sensor (section "Experimental Setup"), CARLA's ray-cast LiDAR with 64 channels.

    `lasers`, from below to above, replace evenly spaced channels. A `rolling` sensor fires each column of its turn at
    its own time and place; CARLA's fires all at the end. `beam` is its width, None for a mathematical line.
    """

    channels: int = 64
    upper_elevation_rad: float = math.radians(10.0)
    lower_elevation_rad: float = math.radians(-30.0)
    range_m: float = 100.0
    points_per_second: int = 800_000
    rate_hz: float = 30.0
    height_m: float = 2.4
    range_sd_m: float = 0.01
    near_m: float = 0.0
    lasers: tuple[Laser, ...] = ()
    clockwise: bool = True
    rolling: bool = False
    beam: Beam | None = None
    returns: Returns = field(default_factory=CarlaReturns)

    def __post_init__(self) -> None:
        if self.lasers and len(self.lasers) != self.channels:
            raise ValueError(f"a LiDAR of {self.channels} channels has that many lasers, not {len(self.lasers)}")
        if self.channels < 1 or not 0 < self.rate_hz < math.inf or self.columns < 1:
            raise ValueError("a LiDAR has a channel, a rate and enough points a second for one column of its turn")
        if not (0 <= self.near_m < self.range_m and 0 <= self.range_sd_m < math.inf):
            raise ValueError("a LiDAR measures from near_m >= 0 to a larger range_m, with a noise that is not negative")

    @property
    def columns(self) -> int:
        """Directions of azimuth in one turn."""
        return int(self.points_per_second / self.rate_hz / self.channels)

    @property
    def elevations_rad(self) -> FloatArray:
        """Elevation of each ring, (channels,); ring 0 looks down most."""
        if self.lasers:
            return np.array([laser.elevation_rad for laser in self.lasers])
        return np.linspace(self.lower_elevation_rad, self.upper_elevation_rad, self.channels)

    @property
    def heights_m(self) -> FloatArray:
        """Height above the sensor's origin that each ring's light comes from, (channels,)."""
        return np.array([laser.height_m for laser in self.lasers]) if self.lasers else np.zeros(self.channels)

    @property
    def range_biases_m(self) -> Float32Array:
        """What each ring adds to every range, (channels,)."""
        biases = [laser.range_bias_m for laser in self.lasers] if self.lasers else np.zeros(self.channels)
        return np.array(biases, dtype=np.float32)


def azimuths(lidar: LidarModel, phase: float) -> FloatArray:
    """Azimuth of each column (columns,), counter-clockwise from ahead, in the order of firing.

    The turn begins and ends behind the sensor; `phase` in [0, 1) shifts the grid by that part of a column.
    """
    turned: FloatArray = np.multiply(np.arange(lidar.columns) + phase, 2 * math.pi / lidar.columns)
    return math.pi - turned if lidar.clockwise else turned - math.pi


def firing_offsets(lidar: LidarModel) -> FloatArray:
    """Time of each column (columns,) relative to the end of the turn: zero for the last, or for all if not rolling."""
    if not lidar.rolling:
        return np.zeros(lidar.columns)
    offset_s: FloatArray = (np.arange(lidar.columns) + 1 - lidar.columns) / (lidar.columns * lidar.rate_hz)
    return offset_s


def measure(
    world: World, lidar: LidarModel, motion: Motion, end_s: float, rng: np.random.Generator, ignored_mover: int = 0
) -> Sweep:
    """The turn that ends at `end_s` of a sensor carried by `motion`, with its own azimuth phase; misses are left out.

    The noise of the range lies along the rays. `ignored_mover` is the vehicle that carries the sensor.
    """
    azimuth, offset_s = azimuths(lidar, rng.uniform()), firing_offsets(lidar)
    street_from_sensor = np.ascontiguousarray(motion.poses(end_s + offset_s), dtype=np.float64)
    height_m, elevation = lidar.heights_m, lidar.elevations_rad
    origins, rays = _rays(azimuth, elevation, height_m, street_from_sensor)
    noise_m = rng.standard_normal(len(rays), dtype=np.float32) * np.float32(lidar.range_sd_m)

    shots = Shots(
        origins, rays, np.repeat(end_s + offset_s, lidar.channels), lidar.channels, lidar.range_m, ignored_mover
    )
    hits = world.cast(origins, rays, shots.time_s, ignored_mover, lidar.range_m)
    struck, surface = hits.part, world.classes(hits, _reached(origins, rays, hits.distance))
    power = received_power(hits, rays, surface)
    if lidar.beam is not None:
        hits, power = spread(world, lidar.beam, shots, hits, power)
    intensity, kept = lidar.returns.receive(hits.distance, power, rng)
    kept &= (hits.distance >= lidar.near_m) & (hits.distance <= lidar.range_m)

    index = np.flatnonzero(kept)
    column, ring = np.divmod(index, lidar.channels)
    error_m = noise_m[index] + lidar.range_biases_m[ring]
    hit_m, cosine = _arrivals(index, origins, rays, hits.distance, hits.normal)
    elsewhere = hits.part[index] != struck[index]
    hits = _taken(hits, index)
    return Sweep(
        points_m=_points(column, ring, hits.distance + error_m, azimuth, elevation, height_m),
        ring=ring.astype(np.uint16),
        azimuth_rad=azimuth.astype(np.float32)[column],
        time_offset_s=offset_s.astype(np.float32)[column],
        intensity=intensity[index],
        cos_incidence=cosine,
        # Where the rim of a beam met something else, the class of that; an edge of paint is finer than a beam.
        surface=np.where(elsewhere, world.surfaces(hits), surface[index]),
        obstacle_id=world.obstacle_ids(hits, hit_m),
        mover_id=hits.mover,
    )


def _taken(hits: Hits, index: NDArray[np.intp]) -> Hits:
    # `take` gathers rows several times as fast as an index in brackets does.
    return replace(hits, **{column.name: getattr(hits, column.name).take(index, axis=0) for column in fields(hits)})


@njit(cache=True, nogil=True)
def _reached(origins: Float32Array, rays: Float32Array, distance: Float32Array) -> Float32Array:
    """Where rays arrive (N, 3), their origins for those that hit nothing."""
    points = origins.copy()
    for i in range(len(rays)):
        if np.isfinite(distance[i]):
            for axis in range(3):
                points[i, axis] += rays[i, axis] * distance[i]
    return points


@njit(cache=True, nogil=True)
def _arrivals(
    index: NDArray[np.intp], origins: Float32Array, rays: Float32Array, distance: Float32Array, normal: Float32Array
) -> tuple[FloatArray, Float32Array]:
    """Where the rays of an index arrive (n, 3), frame `street`, and the cosines of their angles of incidence (n,)."""
    hit_m = np.empty((len(index), 3))
    cosine = np.empty(len(index), dtype=np.float32)
    for row in range(len(index)):
        i = index[row]
        dot = np.float32(0.0)
        for axis in range(3):
            hit_m[row, axis] = origins[i, axis] + rays[i, axis] * distance[i]
            dot += rays[i, axis] * normal[i, axis]
        cosine[row] = min(abs(dot), np.float32(1.0))
    return hit_m, cosine


@njit(cache=True, nogil=True)
def _rays(
    azimuth: FloatArray, elevation: FloatArray, height_m: FloatArray, street_from_sensor: FloatArray
) -> tuple[Float32Array, Float32Array]:
    """Origins and unit directions (N, 3), frame `street`, of every column at its own pose (columns, 4, 4)."""
    channels = len(elevation)
    origins = np.empty((len(azimuth) * channels, 3), dtype=np.float32)
    rays = np.empty_like(origins)
    flat, up = np.cos(elevation), np.sin(elevation)
    for column in range(len(azimuth)):
        cos, sin = math.cos(azimuth[column]), math.sin(azimuth[column])
        pose = street_from_sensor[column]
        for axis in range(3):
            along = pose[axis, 0] * cos + pose[axis, 1] * sin
            for ring in range(channels):
                rays[column * channels + ring, axis] = flat[ring] * along + up[ring] * pose[axis, 2]
                origins[column * channels + ring, axis] = pose[axis, 3] + height_m[ring] * pose[axis, 2]
    return origins, rays


@njit(cache=True, nogil=True)
def _points(
    column: NDArray[np.intp],
    ring: NDArray[np.intp],
    range_m: Float32Array,
    azimuth: FloatArray,
    elevation: FloatArray,
    height_m: FloatArray,
) -> Float32Array:
    """Points (N, 3), frame `sensor` at the moment each was fired."""
    points = np.empty((len(ring), 3), dtype=np.float32)
    cos, sin = np.cos(azimuth), np.sin(azimuth)
    flat, up = np.cos(elevation), np.sin(elevation)
    for i in range(len(ring)):
        along = range_m[i] * flat[ring[i]]
        points[i, 0] = along * cos[column[i]]
        points[i, 1] = along * sin[column[i]]
        points[i, 2] = range_m[i] * up[ring[i]] + height_m[ring[i]]
    return points
