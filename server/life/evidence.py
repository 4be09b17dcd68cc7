"""Who saw an obstacle and who missed it: passes, runs of absence, removal, confidence. All pure."""

from __future__ import annotations

import math
from bisect import bisect_left
from datetime import datetime

from server.life.obstacle import Obstacle, Witness
from server.life.policy import Life, Times

# Late reports of an offline vehicle are recognised as one pass as long as its passes are among these.
_REMEMBERED_PASSES = 16


def witness_of(obstacle: Obstacle, name: str) -> Witness:
    """The evidence of a witness, empty if it has none."""
    for witness in obstacle.evidence:
        if witness.name == name:
            return witness
    return Witness(name)


def is_same_pass(witness: Witness, at: datetime, times: Times) -> bool:
    """Whether the witness has already seen the obstacle in this pass."""
    if not witness.seen_at:  # of nearly all obstacles that nearly all vehicles come by
        return False
    later = bisect_left(witness.seen_at, at)
    return any(abs(at - seen_at) < times.one_pass for seen_at in witness.seen_at[max(0, later - 1) : later + 1])


def with_sighting(witness: Witness, at: datetime, times: Times) -> Witness:
    """The witness after a sighting; within a pass the pass's moment moves on, so that a parked car counts once."""
    passes = set(witness.seen_at)
    if is_same_pass(witness, at, times):
        passes = {max(seen_at, at) if abs(at - seen_at) < times.one_pass else seen_at for seen_at in witness.seen_at}
    if passes == set(witness.seen_at):
        passes.add(at)
    return Witness(witness.name, tuple(sorted(passes)[-_REMEMBERED_PASSES:]), witness.absent_at)


def with_witness(obstacle: Obstacle, witness: Witness) -> tuple[Witness, ...]:
    """The obstacle's evidence with that of one witness replaced."""
    return (*(other for other in obstacle.evidence if other.name != witness.name), witness)


def closed_if_outweighed(obstacle: Obstacle) -> Obstacle:
    """Close the run of absences when at least as many witnesses have seen the obstacle since it began."""
    if obstacle.absent_since is None:
        return obstacle
    absent, seen = _since_first_absence(obstacle)
    return obstacle._replace(absent_since=None) if seen >= absent else obstacle


def is_refuted(obstacle: Obstacle, life: Life) -> bool:
    """Whether the absences remove it: a - s >= 2 + floor(log10(passes with a sighting)), or 1 for a single witness."""
    absent, seen = _since_first_absence(obstacle)
    return absent - seen >= _witnesses_to_remove(obstacle, life)


def risen(confidence: float, as_of: datetime, sighting: float, at: datetime, half_life_s: float, life: Life) -> float:
    """Confidence after a sighting, as of the later of both moments; each has decayed until then."""
    until = max(as_of, at)
    held = confidence * _decay(as_of, until, half_life_s)
    gained = life.sighting_weight * sighting * _decay(at, until, half_life_s)
    return 1 - (1 - held) * (1 - gained)


def sunk(confidence: float, as_of: datetime, at: datetime, half_life_s: float, life: Life) -> float:
    """Confidence after an absence that counted, as of `at`."""
    return confidence * _decay(as_of, max(as_of, at), half_life_s) * life.absence_factor


def _decay(since: datetime, until: datetime, half_life_s: float) -> float:
    return float(0.5 ** ((until - since).total_seconds() / half_life_s))


def _since_first_absence(obstacle: Obstacle) -> tuple[int, int]:
    """Distinct witnesses whose latest evidence since the first open absence is absence, and those with a sighting."""
    since = obstacle.absent_since
    if since is None:
        return 0, 0
    absent = seen = 0
    for witness in obstacle.evidence:
        last_seen = witness.last_seen_at or datetime.min.replace(tzinfo=since.tzinfo)
        if witness.absent_at is not None and witness.absent_at >= since and witness.absent_at > last_seen:
            absent += 1
        elif last_seen >= since:
            seen += 1
    return absent, seen


def _witnesses_to_remove(obstacle: Obstacle, life: Life) -> int:
    # What only one witness ever saw is removed by its own absence or that of one other.
    if obstacle.witness_count <= 1:
        return 1
    return life.removing_witnesses + life.removing_witnesses_per_decade * int(math.log10(obstacle.sightings))
