"""How far a report reaches: the tiles that it locks, and the stored obstacles that it could match or merge."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from uuid import UUID

from contract.geometry import LatLon
from contract.observation import ObservationReport
from server.geometry.geodesy import is_within, offset_from
from server.geometry.quadkey import Ranges, cover, window
from server.geometry.symmetric import greatest_sd_m
from server.life.policy import Policy


@dataclass(frozen=True, slots=True)
class Near:
    """Where obstacles lie that detections could match or merge with: the better one is known, the nearer it must be.

    Detections lie within `half_m` of the centre, and with their report's pose are known to `measured_m2` (variances of
    the widest axes); `gates` standard deviations of both are as far as a match, and a merge after it, can go.
    """

    centre: LatLon
    half_m: float
    measured_m2: float
    gates: float

    def radius_m(self, variances_m2: float) -> float:
        """How far away an obstacle may lie whose variances along east and north add up to that."""
        return self.half_m + self.gates * math.sqrt(self.measured_m2 + variances_m2)


@dataclass(frozen=True, slots=True)
class Reach:
    """All that a report can concern, within the tiles that it locks.

    Of the obstacles in the cells of `far` those that lie `near`, those `inspected`, and those that are badly known: the
    variances of their places (east and north) add up to more than `well_known_m2`. What is well known and near lies in
    `near_cells`.
    """

    tiles: tuple[int, ...]
    near: Near | None
    near_cells: Ranges
    far: Ranges
    inspected: frozenset[UUID]
    well_known_m2: float

    def concerns(self, identifier: UUID, position: LatLon, variances_m2: float) -> bool:
        """Whether the report can concern an obstacle in the cells of `far`."""
        if variances_m2 > self.well_known_m2 or identifier in self.inspected:
            return True
        return self.near is not None and is_within(self.near.centre, position, self.near.radius_m(variances_m2))


NOWHERE = Reach((), None, (), (), frozenset(), 0.0)
"""Of what changes nothing, whatever it says."""


def reach_of(message: ObservationReport, policy: Policy) -> Reach:
    """What lies within what the report saw, the gate, and an obstacle's drift."""
    limits = policy.plausibility
    seen_m = max((math.hypot(item.east_m, item.north_m) for item in message.detections), default=0.0)
    reach_m = limits.reach_m if message.inspections else min(seen_m, limits.reach_m)
    radius_m = reach_m + policy.gate_m + policy.matching.greatest_drift_m
    near, well_known_m2 = _near(message, policy), policy.matching.well_known_sd_m**2
    around = window(message.origin.position, radius_m)
    return Reach(
        tiles=around.tiles(),
        near=near,
        near_cells=() if near is None else cover(near.centre, near.radius_m(well_known_m2)),
        far=around.cover(),
        inspected=frozenset(item.obstacle_id for item in message.inspections),
        well_known_m2=well_known_m2,
    )


def _near(message: ObservationReport, policy: Policy) -> Near | None:
    limits, matching = policy.plausibility, policy.matching
    seen = [item for item in message.detections if math.hypot(item.east_m, item.north_m) <= limits.reach_m]
    if not seen:
        return None
    east_m, half_east_m = _middle([item.east_m for item in seen])
    north_m, half_north_m = _middle([item.north_m for item in seen])
    centre_sd_m = min(max(greatest_sd_m(item.covariance) for item in seen), limits.greatest_centre_sd_m)
    measured_sd_m = math.hypot(greatest_sd_m(message.origin.covariance), centre_sd_m)
    # What matched is then known at least as well as it was measured, and merges with what agrees with that. Both
    # stored places count with their least variance.
    return Near(
        centre=offset_from(message.origin.position, east_m, north_m),
        half_m=math.hypot(half_east_m, half_north_m),
        measured_m2=measured_sd_m**2 + 2 * matching.least_stored_sd_m**2,
        gates=math.sqrt(matching.gate_chi_square) + math.sqrt(matching.merging_chi_square),
    )


def _middle(values: Sequence[float]) -> tuple[float, float]:
    """Middle and half-width of the range of values."""
    low, high = min(values), max(values)
    return (low + high) / 2, (high - low) / 2
