"""Streets that change: which street stands when, and the truth of every obstacle over time."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simulator.readings import ObstacleTruth
from simulator.streets.street import GeoReference, PlacedObstacle, Street
from simulator.world import World

FloatArray = NDArray[np.float64]

APPEARED, GROWN, REMOVED = "appeared", "grown", "removed"


@dataclass(frozen=True, slots=True)
class Change:
    """What happens to one obstacle at a time of the world's clock: it `appeared`, has `grown`, or was `removed`.

    `area_factor` is that of growth.
    """

    time_s: float
    obstacle_id: int
    what: str
    area_factor: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class ChangingStreet:
    """A street with all obstacles it ever holds, and what changes, in the order of time."""

    street: Street
    changes: tuple[Change, ...] = ()

    def at(self, time_s: float) -> Street:
        """The street as it is at a time."""
        return self._after(bisect_right([change.time_s for change in self.changes], time_s))

    def truth(self) -> tuple[ObstacleTruth, ...]:
        """Rows in the order of time; each holds until the next one of its obstacle."""
        late = {change.obstacle_id for change in self.changes if change.what == APPEARED}
        rows = [
            _row(self.street, placed, "initial", 0.0)
            for placed in self.street.obstacles
            if placed.obstacle_id not in late
        ]
        for number, change in enumerate(self.changes, start=1):
            street = self._after(number - 1 if change.what == REMOVED else number)
            rows.append(_row(street, street.obstacle(change.obstacle_id), change.what, change.time_s))
        return tuple(rows)

    def _after(self, count: int) -> Street:
        absent = {change.obstacle_id for change in self.changes[count:] if change.what == APPEARED}
        obstacles = {o.obstacle_id: o for o in self.street.obstacles if o.obstacle_id not in absent}
        for change in self.changes[:count]:
            placed = obstacles[change.obstacle_id]
            match change.what:
                case "grown":
                    obstacles[change.obstacle_id] = replace(placed, shape=placed.shape.grown(change.area_factor))
                case "removed":
                    obstacles[change.obstacle_id] = replace(placed, filled=True)
        return replace(self.street, obstacles=tuple(obstacles.values()))


class Worlds:
    """Worlds of a changing street, each built when it is first needed; only the latest is kept."""

    def __init__(self, changing: ChangingStreet, build: Callable[[Street], World]) -> None:
        self._changing, self._build = changing, build
        self._times = [change.time_s for change in changing.changes]
        self._count = -1
        self._world: World | None = None

    @property
    def georeference(self) -> GeoReference:
        """Where the street lies on the earth."""
        return self._changing.street.georeference

    @property
    def enu_from_street(self) -> FloatArray:
        """(4, 4), the same at all times."""
        return self._changing.street.enu_from_street

    def at(self, time_s: float) -> World:
        """The world as it is at a time."""
        count = bisect_right(self._times, time_s)
        if self._world is None or count != self._count:
            self._count, self._world = count, self._build(self._changing.at(time_s))
        return self._world


def _row(street: Street, placed: PlacedObstacle, change: str, from_s: float) -> ObstacleTruth:
    enu = street.enu_of(placed.obstacle_id)
    position, altitude_m = street.georeference.geodetic_from_enu(enu)
    shape = placed.shape
    return ObstacleTruth(
        obstacle_id=placed.obstacle_id,
        kind=placed.kind,
        change=change,
        from_s=from_s,
        position=position,
        altitude_m=altitude_m,
        enu_m=(float(enu[0]), float(enu[1]), float(enu[2])),
        yaw_rad=placed.yaw_rad + street.yaw_rad,
        length_m=shape.length_m,
        width_m=shape.width_m,
        relief_m=shape.relief_m,
        area_m2=shape.footprint_area_m2,
        volume_m3=shape.volume_m3,
    )
