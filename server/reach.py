"""How far a report reaches: the tiles that it locks, and the stored obstacles that it could match or merge."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from uuid import UUID

from contract.geometry import LatLon
from contract.observation import ObservationReport
from server.geodesy import is_within, offset_from
from server.policy import Policy
from server.quadkey import Ranges, cover, tiles
from server.symmetric import greatest_sd_m


@dataclass(frozen=True, slots=True)
class Circle:
    """A place and all that lies at most `radius_m` around it."""

    centre: LatLon
    radius_m: float


@dataclass(frozen=True, slots=True)
class Reach:
    """All that a report can concern, within the tiles that it locks.

    In the circle `near` that is every obstacle; in the cells of `far`, which hold it, only what is `inspected` and what
    is badly known: the variances of its place (east and north) add up to more than `well_known_m2`.
    """

    tiles: tuple[int, ...]
    near: Circle | None
    far: Ranges
    inspected: frozenset[UUID]
    well_known_m2: float

    @property
    def near_cells(self) -> Ranges:
        """Ranges of cells that hold `near`."""
        return () if self.near is None else cover(self.near.centre, self.near.radius_m)

    def concerns(self, identifier: UUID, position: LatLon, variances_m2: float) -> bool:
        """Whether the report can concern an obstacle in the cells of `far`."""
        if variances_m2 > self.well_known_m2 or identifier in self.inspected:
            return True
        return self.near is not None and is_within(self.near.centre, position, self.near.radius_m)


NOWHERE = Reach((), None, (), frozenset(), 0.0)
"""Of what changes nothing, whatever it says."""


def reach_of(message: ObservationReport, policy: Policy) -> Reach:
    """What lies within what the report saw, the gate, and an obstacle's drift."""
    limits = policy.plausibility
    seen_m = max((math.hypot(item.east_m, item.north_m) for item in message.detections), default=0.0)
    reach_m = limits.reach_m if message.inspections else min(seen_m, limits.reach_m)
    radius_m = reach_m + policy.gate_m + policy.matching.greatest_drift_m
    centre = message.origin.position
    return Reach(
        tiles=tiles(centre, radius_m),
        near=_near(message, radius_m, policy),
        far=cover(centre, radius_m),
        inspected=frozenset(item.obstacle_id for item in message.inspections),
        well_known_m2=policy.matching.well_known_sd_m**2,
    )


def _near(message: ObservationReport, radius_m: float, policy: Policy) -> Circle | None:
    """Where all well-known obstacles lie that detections could match or merge with, inside the circle that is locked.

    What was matched is then known at least as well as it was measured, and merges with what agrees with that.
    """
    limits, matching = policy.plausibility, policy.matching
    seen = [item for item in message.detections if math.hypot(item.east_m, item.north_m) <= limits.reach_m]
    if not seen:
        return None
    east_m, half_east_m = _middle([item.east_m for item in seen])
    north_m, half_north_m = _middle([item.north_m for item in seen])
    pose_sd_m = greatest_sd_m(message.origin.covariance)
    centre_sd_m = min(max(greatest_sd_m(item.covariance) for item in seen), limits.greatest_centre_sd_m)
    sd_m = math.hypot(pose_sd_m, centre_sd_m, max(matching.well_known_sd_m, matching.least_stored_sd_m))
    gates_m = (math.sqrt(matching.gate_chi_square) + math.sqrt(matching.merging_chi_square)) * sd_m
    locked_m = radius_m - math.hypot(east_m, north_m)
    centre = offset_from(message.origin.position, east_m, north_m)
    return Circle(centre, min(math.hypot(half_east_m, half_north_m) + gates_m, locked_m))


def _middle(values: Sequence[float]) -> tuple[float, float]:
    """Middle and half-width of the range of values."""
    low, high = min(values), max(values)
    return (low + high) / 2, (high - low) / 2
