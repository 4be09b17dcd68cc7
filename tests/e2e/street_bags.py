"""Two cars on the demo's street, as the ROS 2 bags that they would have recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from headsup.demo.simulated import LIDAR_HEIGHT_M, SimulatedSource, drive_on
from simulator.streets.street import Street, first_light_street
from simulator.world import World
from tests.e2e.bag_of_frames import write_bag
from vehicle_client.sources.frame import LidarFrame

SPEED_MPS = 50 / 3.6
SEED = 1
FIRST_FROM_M, FIRST_TO_M = 150.0, 304.0
NEXT_FROM_M, NEXT_TO_M = 110.0, 180.0
"""The next car's bag ends 38 m before the street's first obstacle: further than the detector looks."""

HEIGHT = ("--sensor-height", str(LIDAR_HEIGHT_M))


@dataclass(frozen=True, slots=True)
class StreetBags:
    """The street and what was recorded on it."""

    street: Street
    first: Path
    over_the_first: Path
    """The part of the first car's way that leads over the first obstacle."""
    next: Path


def make_bags(folder: Path) -> StreetBags:
    """Write them; the same bytes every time, but for the folder's name."""
    street = first_light_street(SEED, ())
    world = World(street)
    first = _frames(world, FIRST_FROM_M, FIRST_TO_M, SEED)
    # The first obstacle lies 68 m from the begin, 1.4 m a frame.
    bags = (
        ("first", first),
        ("part", list(islice(first, 25, 60))),
        ("next", _frames(world, NEXT_FROM_M, NEXT_TO_M, SEED + 1)),
    )
    return StreetBags(street, *(write_bag(folder / name, frames) for name, frames in bags))


def _frames(world: World, from_m: float, to_m: float, seed: int) -> Sequence[LidarFrame]:
    return list(SimulatedSource(drive_on(world, from_m, to_m, SPEED_MPS, seed), started_s=1_780_000_000.0))
