"""A street for the detector's tests: a height field and boxes, ray-cast by marching; seeded and deterministic."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Hole:
    """An elliptic hole (negative height: a smooth bump) with steep walls: `steepness` 1 is a paraboloid."""

    x: float
    y: float
    length: float
    width: float
    depth: float
    yaw: float = 0.0
    steepness: float = 4.0

    def height(self, x: Array, y: Array) -> Array:
        u = ((x - self.x) * np.cos(self.yaw) + (y - self.y) * np.sin(self.yaw)) / (self.length / 2)
        v = (-(x - self.x) * np.sin(self.yaw) + (y - self.y) * np.cos(self.yaw)) / (self.width / 2)
        return -self.depth * np.maximum(1.0 - (u * u + v * v) ** self.steepness, 0.0)


@dataclass(frozen=True)
class Block:
    """An axis-aligned box on the ground: debris, a parked car, a wall."""

    x: float
    y: float
    length: float
    width: float
    height: float


@dataclass(frozen=True)
class Street:
    holes: tuple[Hole, ...] = ()
    blocks: tuple[Block, ...] = ()
    crown: float = 0.02
    kerb: float = 0.12
    half_width: float = 3.5

    def ground(self, x: Array, y: Array) -> Array:
        z = -self.crown * np.minimum(np.abs(y), self.half_width)
        z = z + np.where(np.abs(y) > self.half_width, self.kerb, 0.0)
        for hole in self.holes:
            z = z + hole.height(x, y)
        return z


@dataclass(frozen=True)
class Lidar:
    """64 rings, -30 to +10 degrees, 2.4 m over the road, 26.6k points a turn."""

    height: float = 2.4
    noise: float = 0.01
    rings: int = 64
    columns: int = 416
    elevations: tuple[float, float] = (-30.0, 10.0)
    reach: float = 60.0
    directions: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        elevation = np.deg2rad(np.linspace(*self.elevations, self.rings))
        azimuth = np.linspace(-np.pi, np.pi, self.columns, endpoint=False)
        e, a = np.meshgrid(elevation, azimuth, indexing="ij")
        rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1).reshape(-1, 3)
        object.__setattr__(self, "directions", rays)


def cast(
    street: Street,
    lidar: Lidar,
    x: float,
    y: float,
    seed: int,
    near: tuple[float, float, float] | None = None,
    pitch: float = 0.0,
) -> tuple[NDArray[np.float32], Array]:
    """Points (N, 3) in the sensor frame of a sensor over (x, y) looking along +x, and `odom_from_sensor` (4, 4).

    `near` (x, y, radius) casts only the rays that meet flat ground there. `pitch` tilts the sensor without the pose
    knowing, as odometry's error does.
    """
    rng = np.random.default_rng([seed, round(x * 1000) + 10_000_000])
    road_z = float(street.ground(np.array([x]), np.array([y]))[0])
    origin = np.array([x, y, road_z + lidar.height])
    rays = lidar.directions
    rays = np.stack([rays[:, 0], rays[:, 1], rays[:, 2] + pitch * rays[:, 0]], axis=1)
    turn = rng.uniform(0, 2 * np.pi / lidar.columns)
    rays = rays @ np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
    if near is not None:
        rays = rays[rays[:, 2] < -1e-3]
        ground = origin[:2] - rays[:, :2] * (origin[2] / rays[:, 2:3])
        rays = rays[np.hypot(ground[:, 0] - near[0], ground[:, 1] - near[1]) < near[2]]
    t = np.minimum(_march(street, origin, rays, lidar.reach), _blocks(street, origin, rays))
    hit = t < lidar.reach
    t = t[hit] + rng.normal(0.0, lidar.noise, hit.sum())
    sensed = rays[hit] * t[:, None]
    sensed[:, 2] -= pitch * sensed[:, 0]
    odom_from_sensor = np.eye(4)
    odom_from_sensor[:3, 3] = origin
    return sensed.astype(np.float32), odom_from_sensor


def _march(street: Street, origin: Array, rays: Array, reach: float) -> Array:
    """First meeting with the ground: steps of 4 cm of height over the band where ground can be, then bisection."""
    t = np.full(len(rays), np.inf)
    down = np.flatnonzero(rays[:, 2] < -0.02)
    top, bottom = 0.25, -0.35
    start = (top - origin[2]) / rays[down, 2]
    end = np.minimum((bottom - origin[2]) / rays[down, 2], reach + 5)
    low, high = start.copy(), np.full(down.size, np.nan)
    open_ = np.arange(down.size)
    steps = np.maximum(np.ceil((end - start) / 0.05).astype(int), 1)
    step = (end - start) / steps
    for k in range(int(steps.max(initial=0))):
        here = start[open_] + (k + 1) * step[open_]
        below = _under(street, origin, rays[down[open_]], here)
        found = open_[below]
        high[found] = here[below]
        low[found] = here[below] - step[found]
        open_ = open_[~below & (k + 1 < steps[open_])]
        if open_.size == 0:
            break
    hit = np.isfinite(high)
    low, high, rows = low[hit], high[hit], down[hit]
    for _ in range(8):
        middle = 0.5 * (low + high)
        below = _under(street, origin, rays[rows], middle)
        low, high = np.where(below, low, middle), np.where(below, middle, high)
    t[rows] = 0.5 * (low + high)
    return t


def _under(street: Street, origin: Array, rays: Array, t: Array) -> NDArray[np.bool_]:
    p = origin + rays * t[:, None]
    return p[:, 2] < street.ground(p[:, 0], p[:, 1])


def _blocks(street: Street, origin: Array, rays: Array) -> Array:
    t = np.full(len(rays), np.inf)
    safe = np.where(np.abs(rays) < 1e-12, 1e-12, rays)
    for block in street.blocks:
        base = float(street.ground(np.array([block.x]), np.array([block.y]))[0])
        low = np.array([block.x - block.length / 2, block.y - block.width / 2, base - 0.2])
        high = np.array([block.x + block.length / 2, block.y + block.width / 2, base + block.height])
        a, b = (low - origin) / safe, (high - origin) / safe
        enter, leave = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
        hit = (enter < leave) & (enter > 0)
        t[hit] = np.minimum(t[hit], enter[hit])
    return t


CARS_AND_WALL = (
    Block(12.0, -2.6, 4.2, 1.7, 1.5),
    Block(22.0, 2.6, 4.2, 1.7, 1.5),
    Block(20.0, 7.0, 80.0, 0.3, 2.5),
)
