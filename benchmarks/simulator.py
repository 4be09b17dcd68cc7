"""How many LiDAR turns a second the simulator makes, and where the time goes.

Each round measures one turn in three ways, one after the other, so that what else the machine does falls on all:
the whole sensor on a moving car; bare ray casting of its central rays; and the same sensor written in plain numpy
(a standing sensor with lines for beams: no distortion, mixed pixels, intensity or losses). Ratios are medians over
the rounds.

Example:

    python -m benchmarks.simulator --rounds 20
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.mesh import pose
from simulator.sensors.lidar import LidarModel, azimuths
from simulator.sensors.lidar_presets import LIDAR_PRESETS
from simulator.streets.street import LANE_CENTRE_M, first_light_street
from simulator.world import Hits, World

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Driving:
    """Straight along the street at 10 m/s."""

    height_m: float

    def poses(self, time_s: FloatArray) -> FloatArray:
        """Poses (N, 4, 4) at times (N,)."""
        poses = np.tile(pose(100.0, LANE_CENTRE_M, self.height_m), (len(time_s), 1, 1))
        poses[:, 0, 3] += 10.0 * time_s
        return poses


class TimedWorld(World):
    """A world that knows how long its ray casting took."""

    casting_s = 0.0

    def cast(self, *arguments: Any, **named: Any) -> Hits:
        """As `World.cast`."""
        start = time.perf_counter()
        hits = super().cast(*arguments, **named)
        self.casting_s += time.perf_counter() - start
        return hits


def rays_of(lidar: LidarModel) -> FloatArray:
    """Directions (N, 3) of the central rays of a turn, in plain numpy."""
    azimuth, elevation = (a.ravel() for a in np.meshgrid(azimuths(lidar, 0.5), lidar.elevations_rad, indexing="ij"))
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1)


def plain_numpy(
    world: World, lidar: LidarModel, street_from_sensor: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Points of a turn of a standing sensor with lines for beams and noisy ranges, labelled; nothing compiled."""
    rays = rays_of(lidar)
    noise_m = rng.normal(0.0, lidar.range_sd_m, len(rays))
    origin = street_from_sensor[:3, 3]
    street_rays = rays @ street_from_sensor[:3, :3].T
    hits = world.cast(origin.astype(np.float32), street_rays.astype(np.float32))
    range_m = hits.distance.astype(np.float64)
    returned = range_m <= lidar.range_m
    world.obstacle_ids(hits, origin + street_rays * np.where(returned, range_m, 0.0)[:, None])
    world.surfaces(hits)
    return np.asarray(rays[returned] * (range_m + noise_m)[returned, None])


def seconds(action: Callable[[], object]) -> float:
    """Duration of one call."""
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def row(name: str, lidar: LidarModel, world: TimedWorld, rounds: int) -> str:
    """A line of the table."""
    rng = np.random.default_rng(1)
    motion = Driving(lidar.height_m)
    here = motion.poses(np.zeros(1))[0]
    origin, rays = here[:3, 3].astype(np.float32), rays_of(lidar).astype(np.float32)
    whole, casting, bare, plain, points = [], [], [], [], 0
    for count in range(-2, rounds):  # the first two compile and warm the caches
        world.casting_s = 0.0
        start = time.perf_counter()
        points = len(world.sweep(lidar, motion, count / 10, rng).ring)
        took = time.perf_counter() - start
        if count >= 0:
            whole.append(took)
            casting.append(world.casting_s / took)
            bare.append(took / seconds(lambda: world.cast(origin, rays)))
            plain.append(took / seconds(lambda: plain_numpy(world, lidar, here, rng)))
    rate, share = 1 / float(np.median(whole)), 100 * float(np.median(casting))
    cells = (name, f"{len(rays):,}", f"{points:,}", f"{rate:.1f}", f"{points * rate / 1e6:.2f}", f"{share:.0f} %")
    return "| " + " | ".join((*cells, f"{np.median(bare):.1f}", f"{np.median(plain):.2f}")) + " |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=20, help="turns to measure of each sensor (default 20)")
    rounds = parser.parse_args().rounds
    if rounds < 1:
        parser.error("--rounds must be 1 or more")
    world = TimedWorld(first_light_street(seed=3))
    triangles = sum(len(part.mesh.triangles) for part in world.parts)
    print(f"first_light_street(3), {triangles:,} triangles, {os.cpu_count()} cores, {rounds} rounds\n")
    print(
        "| preset | rays | returns | turns/s | million returns/s | ray casting | time / bare casting | time / numpy |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for name, make in LIDAR_PRESETS.items():
        print(row(name, make(), world, rounds), flush=True)


if __name__ == "__main__":
    main()
