"""The bags of `headsup simulate bags`, and a part of the first one."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from headsup.demo.simulated import calibration
from headsup.simulate.street_bags import first_car, second_car, street
from simulator.streets.street import Street
from simulator.world import World
from vehicle_client.recording.ros_bag import write_bag


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
    along = street()
    world = World(along)
    first = list(first_car(world))
    # The first obstacle lies 68 m from the begin, 1.4 m a frame.
    mounted = calibration().vehicle_from_sensor
    bags = (("first", first), ("part", islice(first, 25, 60)), ("next", second_car(world)))
    return StreetBags(along, *(write_bag(folder / name, frames, mounted) for name, frames in bags))
