"""The rule: what a report means for the obstacles nearby. Pure: values in, values out; the time is a value.

The paper's section on storage and communication, made exact: plausible, known, changed, gone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime
from enum import StrEnum
from operator import attrgetter
from typing import Any
from uuid import UUID

from contract.geometry import Kind
from contract.observation import DecisionKind, Detection, Inspection, ObservationReport, Outcome, State
from server.geometry.geodesy import distance_m, is_within
from server.geometry.quadkey import cell_of, shard_of_cell
from server.geometry.symmetric import greatest_sd_m
from server.life import change, evidence, matching, merging, shaping
from server.life.identity import obstacle_id
from server.life.obstacle import Obstacle, Witness
from server.life.placing import fused_place, measured_place
from server.life.plausibility import detection_rejection
from server.life.policy import Policy

DISTRUSTED = "witness-distrusted"
"""Reason of every decision about a report that is only logged."""


@dataclass(frozen=True, slots=True)
class Report:
    """A vehicle's message with what the server knows of it: who sent it, and its time after correcting the clock.

    What a witness reports that is not `trusted` is answered and logged, and changes nothing.
    """

    message: ObservationReport
    observed_at: datetime
    key_id: str
    witness: str
    trusted: bool = True


class Verdict(StrEnum):
    """What became of an inspection."""

    COUNTED = "counted"
    IGNORED = "ignored"
    REMOVED = "removed"


class Aftermath(StrEnum):
    """What the report as a whole did to obstacles, besides what it said of each."""

    TOLD_APART = "told-apart"
    MERGED = "merged"


@dataclass(frozen=True, slots=True)
class Decision:
    """One decision: about a detection or an inspection (its index in the report), and the obstacle's new value.

    `obstacle` is None when nothing stored is concerned; decisions about one obstacle build on each other in order. An
    aftermath has no index.
    """

    outcome: DecisionKind | Verdict | Aftermath
    reason: str
    index: int | None
    obstacle: Obstacle | None = None


def decide(report: Report, nearby: tuple[Obstacle, ...], now: datetime, policy: Policy) -> list[Decision]:
    """Decide about every detection, then every inspection of a report, each in the report's order, then its aftermath.

    `nearby` holds all obstacles, removed ones too, that could match. `now` is the time of receipt and goes into the
    ids of created obstacles only.
    """
    return _Reading(report, nearby, now, policy).decisions()


class _Reading:
    """The state of one decision: obstacles by id as they stand after the decisions so far."""

    def __init__(self, report: Report, nearby: tuple[Obstacle, ...], now: datetime, policy: Policy) -> None:
        self._report, self._now, self._policy = report, now, policy
        self._at = report.observed_at
        self._current: dict[UUID, Obstacle] = {obstacle.id: obstacle for obstacle in nearby}
        self._tombstones = tuple(obstacle for obstacle in nearby if obstacle.closed_until is not None)
        self._rejections = [
            detection_rejection(detection, policy.plausibility) for detection in report.message.detections
        ]
        self._obstacle_of = self._match(tuple(obstacle for obstacle in nearby if obstacle.is_live))

    def decisions(self) -> list[Decision]:
        message = self._report.message
        if not self._report.trusted:
            return _distrusted(message)
        detections = [self._kept(self._detected(*item)) for item in enumerate(message.detections)]
        inspections = [self._kept(self._inspected(*item)) for item in enumerate(message.inspections)]
        return detections + inspections + self._told_apart() + self._merged()

    def _kept(self, decision: Decision) -> Decision:
        if decision.obstacle is not None:
            self._current[decision.obstacle.id] = decision.obstacle
        return decision

    def _told_apart(self) -> list[Decision]:
        """What one vehicle saw side by side, in one report or in one pass, is never one."""
        if not self._obstacle_of:
            return []
        reported = set(self._obstacle_of.values())
        seen = [item for item in self._current.values() if item.id in reported or self._saw_in_this_pass(item)]
        learned = merging.told_apart(seen, self._policy.matching)
        return [self._kept(Decision(Aftermath.TOLD_APART, "side-by-side", None, item)) for item in learned.values()]

    def _saw_in_this_pass(self, obstacle: Obstacle) -> bool:
        witness = evidence.witness_of(obstacle, self._report.witness)
        return obstacle.is_live and evidence.is_same_pass(witness, self._at, self._policy.times)

    def _merged(self) -> list[Decision]:
        """Obstacles of this report that turn out to be another one, now that their places are known better."""
        decisions: list[Decision] = []
        for identifier in dict.fromkeys(self._obstacle_of.values()):
            obstacle = self._current[identifier]
            twin = merging.twin(obstacle, self._current.values(), self._policy.matching) if obstacle.is_live else None
            if twin is None:
                continue
            older, _ = before = sorted((obstacle, twin), key=lambda item: item.id)
            after = merging.merged(obstacle, twin, self._policy.matching)
            reason = f"one-with-{older.id}"
            decisions += [
                self._kept(Decision(Aftermath.MERGED, reason, None, _revised(*pair)))
                for pair in zip(before, after, strict=True)
            ]
        return decisions

    def _match(self, live: tuple[Obstacle, ...]) -> dict[int, UUID]:
        """Obstacle of each matched detection, by the detection's index in the report."""
        plausible = [index for index, rejection in enumerate(self._rejections) if rejection is None]
        detections = [self._report.message.detections[index] for index in plausible]
        matches = matching.match(self._report.message, detections, live, self._policy.matching)
        self._shift_m = matches.shift_m
        return {plausible[d]: live[o].id for d, o in matches.obstacle_of.items()}

    def _detected(self, index: int, detection: Detection) -> Decision:
        if rejection := self._rejections[index]:
            return Decision(DecisionKind.REJECTED, rejection, index)
        if index in self._obstacle_of:
            return self._seen_again(index, detection, self._current[self._obstacle_of[index]])
        if (owner := self._piece_of(detection)) is not None:
            return Decision(DecisionKind.KEPT, "part-of-another-detection", index, self._current[owner])
        return self._new(index, detection)

    def _piece_of(self, detection: Detection) -> UUID | None:
        owners = list(self._obstacle_of.items())
        others = [self._report.message.detections[index] for index, _ in owners]
        joined = matching.joined_to(detection, others, self._policy.matching)
        return None if joined is None else owners[joined][1]

    def _new(self, index: int, detection: Detection) -> Decision:
        predecessor = self._tombstone(detection)
        closed_until = predecessor.closed_until if predecessor else None
        if predecessor is not None and closed_until is not None and self._at <= closed_until:
            return Decision(DecisionKind.SUPERSEDED, "removed-since", index, predecessor)
        obstacle = self._created(index, detection, predecessor.id if predecessor else None)
        self._obstacle_of[index] = obstacle.id
        return Decision(DecisionKind.CREATED, "succeeds-a-removed-one" if predecessor else "new", index, obstacle)

    def _tombstone(self, detection: Detection) -> Obstacle | None:
        """The latest removed obstacle at the detection's place."""
        at_the_place = [
            stone for stone in self._tombstones if stone.sign is detection.sign and self._is_at(detection, stone)
        ]
        return max(at_the_place, key=lambda stone: stone.closed_until or stone.last_seen, default=None)

    def _is_at(self, detection: Detection, obstacle: Obstacle) -> bool:
        message, policy = self._report.message, self._policy.matching
        return matching.same_level(message, detection.up_m, obstacle.place, policy) and (
            matching.residual_chi_square(detection, self._shift_m, message.origin.position, obstacle.place, policy)
            <= policy.gate_chi_square
        )

    def _created(self, index: int, detection: Detection, succeeds: UUID | None) -> Obstacle:
        place = measured_place(self._report.message.origin, detection)
        shard = shard_of_cell(cell_of(place.position))
        life = self._policy.life
        return Obstacle(
            id=obstacle_id(self._now, shard, self._report.key_id, self._report.message.report_id, index),
            shard=shard,
            kind=detection.kind,
            kind_votes={detection.kind: 1},
            state=State.CONFIRMED if life.confirming_witnesses <= 1 else State.CANDIDATE,
            version=1,
            revision=1,
            born_at=place.position,
            place=place,
            shape=shaping.shape_of(detection, self._at),
            references=(change.measured_size(detection, self._policy.change),),
            pending=None,
            confidence=life.sighting_weight * detection.confidence,
            as_of=self._at,
            first_seen=self._at,
            last_seen=self._at,
            sightings=1,
            witness_count=1,
            evidence=(Witness(self._report.witness, (self._at,)),),
            succeeds=succeeds,
        )

    def _seen_again(self, index: int, detection: Detection, obstacle: Obstacle) -> Decision:
        witness = evidence.witness_of(obstacle, self._report.witness)
        same_pass = evidence.is_same_pass(witness, self._at, self._policy.times)
        if same_pass and shaping.is_better_look(detection, obstacle):
            return Decision(DecisionKind.KEPT, "better-look", index, self._looked_better(detection, obstacle))
        outcome, reason, resized = self._resized(detection, obstacle, same_pass)
        if same_pass:
            resized = resized._replace(evidence=self._pass_extended(resized, witness))
        else:
            sighted = self._sighted(resized, detection.confidence)
            resized = sighted._replace(**self._placed(sighted, detection), **self._voted(sighted, detection))
        return Decision(outcome, reason, index, _revised(obstacle, resized))

    def _resized(self, detection: Detection, obstacle: Obstacle, same_pass: bool) -> tuple[DecisionKind, str, Obstacle]:
        """The obstacle after judging its size; within a pass only a change that is certain at once counts."""
        policy = self._policy.change
        if self._at <= obstacle.shape.observed_at:
            return DecisionKind.KEPT, "same-pass" if same_pass else "earlier-than-the-box", obstacle
        if not change.is_comparable(detection, policy):
            return DecisionKind.KEPT, "size-too-uncertain", obstacle
        measured = change.measured_size(detection, policy)
        verdict = change.judge(measured, obstacle.references, obstacle.pending, policy)
        if same_pass and not (verdict.changed and verdict.new_size is measured):
            return DecisionKind.KEPT, "same-pass", obstacle
        if verdict.new_size is not None:
            return (
                DecisionKind.UPDATED,
                verdict.reason,
                shaping.changed(obstacle, detection, self._at, verdict.new_size),
            )
        return DecisionKind.KEPT, verdict.reason, shaping.kept(obstacle, verdict.references, verdict.pending)

    def _looked_better(self, detection: Detection, obstacle: Obstacle) -> Obstacle:
        """The obstacle after a better look of the only pass that has seen it: its first measurement is replaced."""
        better = obstacle._replace(
            evidence=self._pass_extended(obstacle, evidence.witness_of(obstacle, self._report.witness)),
            place=measured_place(self._report.message.origin, detection),
            shape=shaping.shape_of(detection, max(self._at, obstacle.shape.observed_at)),
            references=(change.measured_size(detection, self._policy.change),),
            pending=None,
        )
        return _revised(obstacle, better)

    def _pass_extended(self, obstacle: Obstacle, witness: Witness) -> tuple[Witness, ...]:
        """The obstacle's evidence after one more sighting."""
        return evidence.with_witness(obstacle, evidence.with_sighting(witness, self._at, self._policy.times))

    def _sighted(self, obstacle: Obstacle, confidence: float) -> Obstacle:
        """The obstacle after one more pass that saw it."""
        life = self._policy.life
        witness = evidence.witness_of(obstacle, self._report.witness)
        witness_count = obstacle.witness_count + (0 if witness.seen_at else 1)
        is_sure_of_the_place = greatest_sd_m(self._report.message.origin.covariance) <= life.confirming_sd_m
        is_confirmed = obstacle.state is State.CONFIRMED or (
            is_sure_of_the_place and witness_count >= life.confirming_witnesses
        )
        half_life_s = life.half_life_s[obstacle.kind]
        seen = obstacle._replace(
            evidence=self._pass_extended(obstacle, witness),
            state=State.CONFIRMED if is_confirmed else State.CANDIDATE,
            confidence=evidence.risen(obstacle.confidence, obstacle.as_of, confidence, self._at, half_life_s, life),
            as_of=max(obstacle.as_of, self._at),
            first_seen=min(obstacle.first_seen, self._at),
            last_seen=max(obstacle.last_seen, self._at),
            sightings=obstacle.sightings + 1,
            witness_count=witness_count,
        )
        return evidence.closed_if_outweighed(seen)

    def _placed(self, obstacle: Obstacle, detection: Detection) -> dict[str, Any]:
        """The position refined, unless it would drift too far from where it was first well known."""
        policy = self._policy.matching
        place = fused_place(obstacle.place, self._report.message.origin, detection, policy)
        if obstacle.place.variances_m2 > policy.well_known_sd_m**2:
            return {"place": place, "born_at": place.position}
        if not is_within(place.position, obstacle.born_at, policy.greatest_drift_m):
            return {}
        return {"place": place}

    def _voted(self, obstacle: Obstacle, detection: Detection) -> dict[str, Any]:
        """The votes with one more, and the kind that they elect."""
        votes = obstacle.kind_votes | {detection.kind: obstacle.kind_votes.get(detection.kind, 0) + 1}
        return {"kind_votes": votes, "kind": self._elected(obstacle.kind, votes)}

    def _elected(self, kind: Kind, votes: dict[Kind, int]) -> Kind:
        leader = max(votes, key=lambda candidate: votes[candidate])
        leads = votes[leader] - votes.get(kind, 0) >= self._policy.life.kind_hysteresis
        return leader if leads else kind

    def _inspected(self, index: int, inspection: Inspection) -> Decision:
        obstacle = self._current.get(inspection.obstacle_id)
        if obstacle is None:
            return Decision(Verdict.IGNORED, "unknown-or-out-of-reach", index)
        if not obstacle.is_live:
            return Decision(Verdict.IGNORED, "already-removed", index, obstacle)
        if inspection.outcome is Outcome.NOT_VISIBLE:
            return Decision(Verdict.IGNORED, "not-visible", index, obstacle)
        if inspection.outcome is Outcome.PRESENT:
            return self._present(index, obstacle)
        return self._absent(index, inspection, obstacle)

    def _present(self, index: int, obstacle: Obstacle) -> Decision:
        witness = evidence.witness_of(obstacle, self._report.witness)
        if evidence.is_same_pass(witness, self._at, self._policy.times):
            return Decision(Verdict.COUNTED, "same-pass", index, obstacle)
        if not self._is_in_reach(obstacle):
            return Decision(Verdict.IGNORED, "unknown-or-out-of-reach", index, obstacle)
        # Its place was recognised, its size was not measured: worth less than a detection that is certain.
        seen = self._sighted(obstacle, self._policy.life.sighting_weight)
        return Decision(Verdict.COUNTED, "seen", index, _revised(obstacle, seen))

    def _absent(self, index: int, inspection: Inspection, obstacle: Obstacle) -> Decision:
        if doubt := self._doubt_of_absence(inspection, obstacle):
            return Decision(Verdict.IGNORED, doubt, index, obstacle)
        life = self._policy.life
        witness = replace(evidence.witness_of(obstacle, self._report.witness), absent_at=self._at)
        half_life_s = life.half_life_s[obstacle.kind]
        missed = obstacle._replace(
            evidence=evidence.with_witness(obstacle, witness),
            absent_since=obstacle.absent_since or self._at,
            confidence=evidence.sunk(obstacle.confidence, obstacle.as_of, self._at, half_life_s, life),
            as_of=max(obstacle.as_of, self._at),
        )
        if not evidence.is_refuted(missed, life):
            return Decision(Verdict.COUNTED, "missed", index, _revised(obstacle, missed))
        gone = missed._replace(state=State.REMOVED, removed_at=self._at, removed_reason="absent")
        return Decision(Verdict.REMOVED, "enough-witnesses", index, _revised(obstacle, gone))

    def _doubt_of_absence(self, inspection: Inspection, obstacle: Obstacle) -> str | None:
        """Why an absence does not count, or None (server rules, "Removal")."""
        if not self._is_in_reach(obstacle):
            return "unknown-or-out-of-reach"
        if inspection.visible_fraction < self._policy.life.least_visible_fraction:
            return "too-little-visible"
        if self._at <= obstacle.last_seen:
            return "seen-later"
        if not self._is_level_known(obstacle):
            return "height-unknown-or-another-level"
        if any(self._is_at(detection, obstacle) for detection in self._report.message.detections):
            return "something-detected-there"
        witness = evidence.witness_of(obstacle, self._report.witness)
        if evidence.is_same_pass(witness, self._at, self._policy.times):
            return "seen-in-this-pass"
        if witness.absent_at is not None and abs(self._at - witness.absent_at) < self._policy.times.one_pass:
            return "same-pass"
        return None

    def _is_in_reach(self, obstacle: Obstacle) -> bool:
        origin = self._report.message.origin.position
        return distance_m(obstacle.place.position, origin) <= self._policy.plausibility.reach_m

    def _is_level_known(self, obstacle: Obstacle) -> bool:
        origin, policy = self._report.message.origin, self._policy.matching
        sd_m = (origin.altitude_sd_m**2 + obstacle.place.altitude_sd_m**2) ** 0.5
        return sd_m <= policy.level_sd_m and abs(origin.altitude_m - obstacle.place.altitude_m) < policy.level_m


def _revised(before: Obstacle, after: Obstacle) -> Obstacle:
    """The new value with the revision counted up when a served field differs."""
    return after if _served(before) == _served(after) else after._replace(revision=before.revision + 1)


_UNSERVED = {"evidence", "references", "pending", "absent_since", "kind_votes", "distinct_from"}
# Sightings first: they nearly always differ, and at a glance.
_served = attrgetter("sightings", *(name for name in Obstacle._fields if name not in _UNSERVED))


def _distrusted(message: ObservationReport) -> list[Decision]:
    """A witness whose creations others found absent too often is heard, and not believed."""
    detections = [Decision(DecisionKind.REJECTED, DISTRUSTED, index) for index in range(len(message.detections))]
    return detections + [Decision(Verdict.IGNORED, DISTRUSTED, index) for index in range(len(message.inspections))]
