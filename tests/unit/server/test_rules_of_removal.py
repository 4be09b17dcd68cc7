"""Seen and not seen: witnesses, absences, removal, what comes after it."""

from __future__ import annotations

from datetime import timedelta

import pytest
from hypothesis import strategies as st

from contract.geometry import Kind, LatLon
from contract.observation import DecisionKind, State
from server.life.policy import COOPERATION, PAPER, Policy
from server.rules import Verdict
from tests.unit.server.making import HOUR, NOON, Road, absent, detection, kinds, message, present

policies = pytest.mark.parametrize("policy", [COOPERATION, PAPER], ids=["cooperation", "paper"])
sizes = st.tuples(st.integers(400, 3000), st.integers(400, 3000)).map(lambda pair: (max(pair), min(pair)))


def seen_by(*vehicles: str, policy: Policy = COOPERATION) -> Road:
    road = Road(policy)
    for number, vehicle in enumerate(vehicles):
        road.sees(vehicle, NOON + number * HOUR, detection())
    return road


def test_two_witnesses_remove_what_two_have_seen() -> None:
    road = seen_by("ego1", "ego2")
    identifier = road.only.id
    assert road.misses("ego3", NOON + 5 * HOUR, identifier).outcome is Verdict.COUNTED
    assert road.misses("ego4", NOON + 6 * HOUR, identifier).outcome is Verdict.REMOVED
    assert (road.only.state, road.only.removed_reason) == (State.REMOVED, "absent")


def test_one_witness_alone_never_removes_what_others_have_seen() -> None:
    road = seen_by("ego1", "ego2")
    verdicts = [road.misses("ego1", NOON + (5 + day) * HOUR, road.only.id).outcome for day in range(20)]
    assert set(verdicts) == {Verdict.COUNTED}
    assert road.only.is_live


@pytest.mark.parametrize("vehicle", ["ego1", "ego2"])
def test_what_one_witness_saw_is_removed_by_its_own_absence_or_that_of_one_other(vehicle: str) -> None:
    road = seen_by("ego1")
    assert road.misses(vehicle, NOON + HOUR, road.only.id).outcome is Verdict.REMOVED


def test_more_passes_need_more_absences() -> None:
    road = seen_by(*(f"ego{number}" for number in range(10)))
    verdicts = [road.misses(f"car{n}", NOON + (20 + n) * HOUR, road.only.id).outcome for n in range(3)]
    assert verdicts == [Verdict.COUNTED, Verdict.COUNTED, Verdict.REMOVED]


def test_a_sighting_between_closes_the_run_of_absences() -> None:
    road = seen_by("ego1", "ego2")
    road.misses("ego3", NOON + 5 * HOUR, road.only.id)
    road.sees("ego1", NOON + 6 * HOUR, detection())
    assert road.only.absent_since is None
    assert road.misses("ego4", NOON + 7 * HOUR, road.only.id).outcome is Verdict.COUNTED
    assert road.misses("ego3", NOON + 8 * HOUR, road.only.id).outcome is Verdict.REMOVED


def test_presence_without_a_box_counts_as_a_sighting() -> None:
    road = seen_by("ego1")
    (decision,) = road.take(message(inspections=(present(road.only.id),), vehicle="ego2", at=NOON + HOUR))
    assert decision.outcome is Verdict.COUNTED
    assert (road.only.sightings, road.only.state) == (2, State.CONFIRMED)


def test_presence_and_detection_in_one_pass_count_once() -> None:
    road = seen_by("ego1")
    both = message(detection(), inspections=(present(road.only.id),), vehicle="ego2", at=NOON + HOUR)
    road.take(both)
    assert road.only.sightings == 2


@pytest.mark.parametrize(
    ("about", "reason"),
    [
        ({"at": NOON - HOUR}, "seen-later"),
        ({"altitude_m": 30.0}, "height-unknown-or-another-level"),
        ({"altitude_sd_m": 500.0}, "height-unknown-or-another-level"),
        ({"position": LatLon(latitude_deg=38.2486, longitude_deg=21.7346)}, "unknown-or-out-of-reach"),
    ],
)
def test_an_absence_that_proves_nothing_does_not_count(about: dict, reason: str) -> None:
    road = seen_by("ego1")
    looked = message(inspections=(absent(road.only.id),), **{"vehicle": "ego2", "at": NOON + HOUR} | about)
    (decision,) = road.take(looked)
    assert (decision.outcome, decision.reason) == (Verdict.IGNORED, reason)


def test_an_absence_behind_an_obstruction_or_beside_a_detection_does_not_count() -> None:
    road = seen_by("ego1")
    hidden = message(inspections=(absent(road.only.id, 0.3),), vehicle="ego2", at=NOON + HOUR)
    beside = message(detection(kind=Kind.DEBRIS), inspections=(absent(road.only.id),), vehicle="ego3", at=NOON + HOUR)
    reasons = [road.take(sent)[-1].reason for sent in (hidden, beside)]
    assert reasons == ["too-little-visible", "something-detected-there"]


def test_the_paper_removes_at_the_first_absence() -> None:
    road = seen_by("ego1", "ego2", "ego3", policy=PAPER)
    assert road.misses("ego4", NOON + 5 * HOUR, road.only.id).outcome is Verdict.REMOVED


def test_a_late_sighting_does_not_bring_back_what_was_removed_since() -> None:
    road = seen_by("ego1")
    removed = road.only
    road.misses("ego2", NOON + 5 * HOUR, removed.id)
    late = road.sees("ego3", NOON + 4 * HOUR, detection())
    assert (kinds(late), late[0].obstacle.id if late[0].obstacle else None) == (["superseded"], removed.id)
    assert not road.only.is_live


def test_a_later_sighting_makes_a_new_obstacle_that_succeeds_the_removed_one() -> None:
    road = seen_by("ego1")
    removed = road.only
    road.misses("ego2", NOON + 5 * HOUR, removed.id)
    (decision,) = road.sees("ego3", NOON + 6 * HOUR, detection())
    assert decision.outcome is DecisionKind.CREATED
    assert decision.obstacle is not None
    assert (decision.obstacle.succeeds, decision.obstacle.id != removed.id) == (removed.id, True)


def test_a_pass_reported_late_and_twice_counts_once() -> None:
    road = seen_by("ego1", "ego2")
    before = road.only.sightings
    for seconds in (0, 40):
        road.sees("ego2", NOON - HOUR + timedelta(seconds=seconds), detection())
    assert road.only.sightings == before + 1


def test_confidence_rises_with_sightings_and_sinks_with_absences() -> None:
    road, seen = Road(), []
    for number in range(4):
        road.sees(f"ego{number}", NOON + number * HOUR, detection())
        seen.append(road.only.confidence)
    assert seen == sorted(seen)
    assert all(0 < confidence < 1 for confidence in seen)
    road.misses("ego9", NOON + 9 * HOUR, road.only.id)
    assert road.only.confidence < seen[-1]
