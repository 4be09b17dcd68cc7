"""When two stored obstacles turn out to be one, and what becomes of them. Pure.

Server rules, "Matching": two of one sign whose positions agree at 95 %, and that nobody ever saw side by side, merge;
the older id stays.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import combinations
from uuid import UUID

from contract.observation import State
from server.geometry.geodesy import east_north_m, offset_from
from server.geometry.symmetric import covariance_of
from server.life.matching import stored_covariance_m2
from server.life.obstacle import Obstacle, Place
from server.life.policy import Matching

# Remembered neighbours: a street has no more within reach of a bad fix.
_MOST_NEIGHBOURS = 32


def told_apart(seen: Sequence[Obstacle], policy: Matching) -> dict[UUID, Obstacle]:
    """Obstacles that one vehicle saw side by side, each knowing the others near it; only those that learned."""
    if len(seen) < 2:  # a pair
        return {}
    near: dict[UUID, set[UUID]] = {}
    for a, b in combinations(seen, 2):
        if _apart_m(a, b) <= policy.merging_reach_m:
            near.setdefault(a.id, set()).add(b.id)
            near.setdefault(b.id, set()).add(a.id)
    return {
        obstacle.id: obstacle._replace(distinct_from=obstacle.distinct_from | fresh)
        for obstacle in seen
        if (fresh := near.get(obstacle.id, set()) - obstacle.distinct_from)
        and len(obstacle.distinct_from) < _MOST_NEIGHBOURS
    }


def twin(obstacle: Obstacle, others: Iterable[Obstacle], policy: Matching) -> Obstacle | None:
    """The live obstacle that this one is the same as, the nearest in standard deviations; None if there is none."""
    agreeing = [
        (_disagreement(obstacle, other, policy), other.id, other) for other in others if _may_be(obstacle, other)
    ]
    alike = [
        item for item in agreeing if item[0] <= policy.merging_chi_square and _same_level(obstacle, item[2], policy)
    ]
    return min(alike)[2] if alike else None


def merged(a: Obstacle, b: Obstacle, policy: Matching) -> tuple[Obstacle, Obstacle]:
    """The older id with the evidence of both, and the younger, removed. Neither revision is counted up here."""
    older, younger = sorted((a, b), key=lambda obstacle: obstacle.id)
    votes = {
        kind: older.kind_votes.get(kind, 0) + younger.kind_votes.get(kind, 0)
        for kind in dict.fromkeys([*older.kind_votes, *younger.kind_votes])
    }
    place = _fused(older.place, younger.place, policy)
    survivor = older._replace(
        # As for a sighting: what was badly known drifts from here.
        born_at=place.position if older.place.variances_m2 > policy.well_known_sd_m**2 else older.born_at,
        kind_votes=votes,
        state=State.CONFIRMED if State.CONFIRMED in (older.state, younger.state) else older.state,
        place=place,
        confidence=max(older.confidence, younger.confidence),
        as_of=max(older.as_of, younger.as_of),
        first_seen=min(older.first_seen, younger.first_seen),
        last_seen=max(older.last_seen, younger.last_seen),
        sightings=older.sightings + younger.sightings,
        # Names of all witnesses are not at hand: at least as many as the better known one had.
        witness_count=max(older.witness_count, younger.witness_count),
        distinct_from=(older.distinct_from | younger.distinct_from) - {older.id, younger.id},
    )
    gone = younger._replace(
        state=State.REMOVED,
        removed_at=survivor.last_seen,
        removed_reason="merged",
        merged_into=older.id,
    )
    return survivor, gone


def _may_be(a: Obstacle, b: Obstacle) -> bool:
    if a.id == b.id or a.sign is not b.sign or not b.is_live:
        return False
    return b.id not in a.distinct_from and a.id not in b.distinct_from


def _disagreement(a: Obstacle, b: Obstacle, policy: Matching) -> float:
    """Squared Mahalanobis distance of two stored places, 2 degrees of freedom."""
    both = stored_covariance_m2(a.place, policy).plus(stored_covariance_m2(b.place, policy))
    return both.inverse().square(*east_north_m(a.place.position, b.place.position))


def _same_level(a: Obstacle, b: Obstacle, policy: Matching) -> bool:
    apart_m = abs(a.place.altitude_m - b.place.altitude_m)
    return apart_m - 2 * math.hypot(a.place.altitude_sd_m, b.place.altitude_sd_m) < policy.level_m


def _apart_m(a: Obstacle, b: Obstacle) -> float:
    return math.hypot(*east_north_m(a.place.position, b.place.position))


def _fused(a: Place, b: Place, policy: Matching) -> Place:
    """Two places weighed by their inverse covariances."""
    a_information = stored_covariance_m2(a, policy).inverse()
    b_information = stored_covariance_m2(b, policy).inverse()
    fused_m2 = a_information.plus(b_information).inverse()
    pulled = b_information.times(*east_north_m(b.position, a.position))
    a_weight, b_weight = (1 / max(place.altitude_sd_m, 0.01) ** 2 for place in (a, b))
    return Place(
        position=offset_from(a.position, *fused_m2.times(*pulled)),
        covariance=covariance_of(fused_m2.floored(policy.least_stored_sd_m**2)),
        altitude_m=(a_weight * a.altitude_m + b_weight * b.altitude_m) / (a_weight + b_weight),
        altitude_sd_m=(a_weight + b_weight) ** -0.5,
    )
