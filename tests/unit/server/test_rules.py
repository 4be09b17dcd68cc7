"""The rule: known, changed, gone, and what must not make a difference."""

from __future__ import annotations

import math
from datetime import timedelta
from uuid import UUID

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contract.geometry import Kind, LatLon
from contract.observation import DecisionKind, Detection, State
from server.life.policy import COOPERATION, PAPER, Policy
from server.rules import Verdict
from tests.unit.server.making import HOUR, NOON, PATRAS, Road, absent, detection, message, present

policies = pytest.mark.parametrize("policy", [COOPERATION, PAPER], ids=["cooperation", "paper"])
sizes = st.tuples(st.integers(400, 3000), st.integers(400, 3000)).map(lambda pair: (max(pair), min(pair)))


def kinds(decisions: list) -> list[str]:
    return [decision.outcome.value for decision in decisions]


def two_passes(policy: Policy, first: Detection, second: Detection) -> tuple[Road, str]:
    road = Road(policy)
    road.sees("ego1", NOON, first)
    return road, kinds(road.sees("ego2", NOON + HOUR, second))[0]


def test_an_unknown_obstacle_is_created_as_a_candidate() -> None:
    road = Road()
    assert kinds(road.sees("ego1", NOON, detection())) == ["created"]
    assert (road.only.state, road.only.version, road.only.sightings) == (State.CANDIDATE, 1, 1)


def test_a_second_witness_confirms_and_the_same_one_does_not() -> None:
    road = Road()
    road.sees("ego1", NOON, detection())
    assert kinds(road.sees("ego1", NOON + HOUR, detection())) == ["kept"]
    assert (road.only.state, road.only.sightings) == (State.CANDIDATE, 2)
    road.sees("ego2", NOON + 2 * HOUR, detection())
    assert (road.only.state, road.only.sightings, road.only.witness_count) == (State.CONFIRMED, 3, 2)


def test_keeping_moves_revision_and_never_the_version() -> None:
    road, decision = two_passes(COOPERATION, detection(), detection(10.4, 5.3))
    assert (decision, road.only.version, road.only.revision) == ("kept", 1, 2)


@policies
@given(st.lists(st.tuples(sizes, st.floats(-40, 40), st.floats(-40, 40)), min_size=1, max_size=4))
@settings(max_examples=25, deadline=None)
def test_reporting_twice_changes_nothing(policy: Policy, items: list) -> None:
    road = Road(policy)
    seen = [detection(east, north, *size) for size, east, north in items]
    road.sees("ego1", NOON, *seen)
    before = road.served()
    again = road.sees("ego1", NOON + timedelta(seconds=30), *seen)
    assert set(kinds(again)) == {"kept"}
    assert road.served() == before


@given(sizes, sizes, st.floats(0, 2 * math.pi))
@settings(max_examples=40, deadline=None)
def test_the_order_of_two_reports_about_different_obstacles_does_not_matter(
    one: tuple[int, int], other: tuple[int, int], direction_rad: float
) -> None:
    far = detection(60 * math.cos(direction_rad), 60 * math.sin(direction_rad), *other)
    reports = [("ego1", NOON, detection(0, 0, *one)), ("ego2", NOON + HOUR, far)]
    there, back = Road(), Road()
    for report in reports:
        there.sees(*report)
    for report in reversed(reports):
        back.sees(*report)
    assert _without_ids(there) == _without_ids(back)


def _without_ids(road: Road) -> list:
    plain = [o._replace(id=UUID(int=0)) for o in road.obstacles.values()]
    return sorted(plain, key=lambda o: (o.place.position.latitude_deg, o.place.position.longitude_deg))


def resized(length_mm: int) -> Detection:
    return detection(length_mm=length_mm, width_mm=700)


@policies
@pytest.mark.parametrize(
    ("change", "length_mm", "decision"),
    [
        ("growth of 14.9 %", 1149, "kept"),
        ("exactly 15 %", 1150, "kept"),
        ("growth of 15.1 %", 1151, "updated"),
        ("shrinkage of 13.0 %", 870, "kept"),
        ("shrinkage of 13.1 %", 869, "updated"),
    ],
)
def test_the_limit_of_fifteen_percent(policy: Policy, change: str, length_mm: int, decision: str) -> None:
    road, decided = two_passes(policy, resized(1000), resized(length_mm))
    assert decided == decision, change
    assert road.only.version == (2 if decision == "updated" else 1)


@policies
@given(st.integers(20, 500), st.integers(20, 500), st.floats(0, math.pi, exclude_max=True))
@settings(max_examples=40, deadline=None)
def test_exactly_fifteen_percent_is_kept_at_every_size(policy: Policy, a: int, b: int, yaw_rad: float) -> None:
    length_mm, width_mm = 20 * max(a, b), 20 * min(a, b)
    before = detection(length_mm=length_mm, width_mm=width_mm, yaw_rad=yaw_rad)
    after = detection(length_mm=length_mm * 115 // 100, width_mm=width_mm, yaw_rad=yaw_rad)
    _, decision = two_passes(policy, before, after)
    assert decision == "kept"


@given(sizes, sizes)
@settings(max_examples=60, deadline=None)
def test_the_paper_policy_updates_exactly_when_a_ratio_exceeds_fifteen_percent(
    old: tuple[int, int], new: tuple[int, int]
) -> None:
    pairs = [(old[0] * old[1], new[0] * new[1]), (old[0], new[0]), (old[1], new[1])]
    beyond = any(100 * max(pair) > 115 * min(pair) for pair in pairs)
    shared = min(old[0], new[0]) * min(old[1], new[1])
    beyond |= 100 * (pairs[0][0] + pairs[0][1] - shared) > 115 * shared
    _, decision = two_passes(PAPER, detection(0, 0, *old), detection(0, 0, *new))
    assert decision == ("updated" if beyond else "kept")


def test_an_update_replaces_the_box_and_counts_a_version() -> None:
    road, decision = two_passes(COOPERATION, detection(), detection(length_mm=1250))
    assert decision == "updated"
    assert (road.only.version, road.only.shape.box.length_mm, road.only.sightings) == (2, 1250, 2)


def test_a_turned_box_is_a_change_and_a_turned_round_one_is_not() -> None:
    turned = two_passes(COOPERATION, detection(width_mm=500, yaw_rad=0.0), detection(width_mm=500, yaw_rad=1.5))
    round_ = two_passes(COOPERATION, detection(width_mm=900, yaw_rad=0.0), detection(width_mm=900, yaw_rad=1.5))
    assert (turned[1], round_[1]) == ("updated", "kept")


def test_a_yaw_just_below_pi_equals_one_just_above_zero() -> None:
    _, decision = two_passes(PAPER, detection(width_mm=400, yaw_rad=0.005), detection(width_mm=400, yaw_rad=-0.005))
    assert decision == "kept"


def test_depth_has_a_limit_of_its_own() -> None:
    deeper = [two_passes(COOPERATION, detection(), detection(relief_mm=relief))[1] for relief in (118, 125, 126)]
    assert deeper == ["kept", "kept", "updated"]


def test_small_changes_below_the_floor_are_none_in_cooperation() -> None:
    before, after = detection(length_mm=300, width_mm=250), detection(length_mm=348, width_mm=250)
    assert two_passes(COOPERATION, before, after)[1] == "kept"
    assert two_passes(PAPER, before, after)[1] == "updated"


def test_an_insignificant_change_waits_for_a_second_pass() -> None:
    road = Road()
    for number in range(3):
        road.sees(f"ego{number}", NOON + number * HOUR, detection(sd=0.05))
    grown = detection(length_mm=1100, width_mm=770, sd=0.05)
    first = road.sees("ego8", NOON + 8 * HOUR, grown)
    second = road.sees("ego9", NOON + 9 * HOUR, grown)
    assert kinds(first + second) == ["kept", "updated"]
    assert first[0].reason == "change-unconfirmed"
    assert (road.only.version, road.only.shape.box.length_mm) == (2, 1100)


def test_a_pending_change_that_is_not_confirmed_is_dropped() -> None:
    road = Road()
    for number in range(3):
        road.sees(f"ego{number}", NOON + number * HOUR, detection(sd=0.05))
    road.sees("ego8", NOON + 8 * HOUR, detection(length_mm=1100, width_mm=770, sd=0.05))
    road.sees("ego9", NOON + 9 * HOUR, detection(sd=0.05))
    assert road.only.pending is None
    assert road.only.version == 1


def test_slow_growth_is_found_since_the_reference_is_frozen() -> None:
    road, decisions = Road(), []
    for day in range(20):
        length_mm = 1000 + 12 * day
        decisions += road.sees(f"ego{day % 4}", NOON + day * 24 * HOUR, detection(length_mm=length_mm))
    assert kinds(decisions).count("updated") == 1


@pytest.mark.parametrize(
    "unsure", [detection(length_mm=1500, sd=0.2), detection(length_mm=1500, front=False, rear=False)]
)
def test_an_uncertain_or_incomplete_size_only_says_seen_again(unsure: Detection) -> None:
    road, decision = two_passes(COOPERATION, detection(), unsure)
    assert (decision, road.only.shape.box.length_mm, road.only.sightings) == ("kept", 1000, 2)


def test_only_equal_views_are_compared() -> None:
    road, decision = two_passes(COOPERATION, detection(), detection(length_mm=800, rear=False))
    assert (decision, road.only.version) == ("kept", 1)
    assert kinds(road.sees("ego3", NOON + 2 * HOUR, detection(length_mm=1000, rear=False))) == ["updated"]


def test_a_box_is_replaced_only_by_a_later_report() -> None:
    road = Road()
    road.sees("ego1", NOON, detection(length_mm=1300))
    late = road.sees("ego2", NOON - HOUR, detection(length_mm=1000))
    assert (kinds(late), late[0].reason) == (["kept"], "earlier-than-the-box")
    assert road.only.shape.box.length_mm == 1300
    assert road.only.first_seen == NOON - HOUR


def test_a_better_look_in_the_first_pass_refines_without_a_new_version() -> None:
    road = Road()
    road.sees("ego1", NOON, detection(length_mm=800, sd=0.08, rear=False))
    decisions = road.sees("ego1", NOON + timedelta(seconds=3), detection(length_mm=1000, sd=0.02))
    assert (kinds(decisions), decisions[0].reason) == (["kept"], "better-look")
    assert (road.only.version, road.only.sightings, road.only.shape.box.length_mm) == (1, 1, 1000)


def test_noise_hardly_ever_updates() -> None:
    """2.5 % noise on each side: of 5 holes and 200 passes each, at most 0.3 % of the passes update."""
    random, updates = np.random.default_rng(20261122), 0
    for _hole in range(5):
        road = Road()
        for number in range(200):
            length_mm, width_mm = (round(mm * math.exp(random.normal(0, 0.025))) for mm in (900, 700))
            yaw_rad = 0.3 + random.normal(0, 0.05)
            seen = detection(
                length_mm=max(length_mm, width_mm), width_mm=min(length_mm, width_mm), sd=0.025, yaw_rad=yaw_rad
            )
            updates += kinds(road.sees(f"ego{number % 7}", NOON + number * HOUR, seen)).count("updated")
    assert updates <= 3


def test_growth_by_a_quarter_is_found_within_two_passes() -> None:
    random, found = np.random.default_rng(7), 0
    for _hole in range(50):
        road = Road()
        for number in range(5):
            growth = 1.25**0.5 if number >= 3 else 1.0
            length_mm, width_mm = (round(growth * mm * math.exp(random.normal(0, 0.02))) for mm in (900, 700))
            road.sees(f"ego{number}", NOON + number * HOUR, detection(0, 0, length_mm, width_mm, sd=0.02))
        found += road.only.version > 1
    assert found >= 48


@pytest.mark.parametrize(
    ("seen", "reason"),
    [
        (detection(length_mm=30_000), "size"),
        (detection(relief_mm=2), "relief"),
        (detection(confidence=0.01), "confidence"),
        (detection(200, 0), "out-of-reach"),
        (detection(centre_sd_m=9), "position-too-uncertain"),
    ],
)
def test_what_is_implausible_is_rejected_with_the_reason(seen: Detection, reason: str) -> None:
    road = Road()
    (decision,) = road.sees("ego1", NOON, seen)
    assert (decision.outcome, decision.reason) == (DecisionKind.REJECTED, reason)
    assert not road.obstacles


def test_holes_and_things_at_one_place_are_two_obstacles() -> None:
    road = Road()
    road.sees("ego1", NOON, detection())
    road.sees("ego2", NOON + HOUR, detection(kind=Kind.DEBRIS))
    assert len(road.obstacles) == 2


def test_the_kind_is_a_vote_with_hysteresis() -> None:
    road, seen = Road(), []
    for number, kind in enumerate([Kind.BUMP, Kind.DEBRIS, Kind.DEBRIS, Kind.DEBRIS]):
        road.sees(f"ego{number}", NOON + number * HOUR, detection(kind=kind))
        seen.append(road.only.kind)
    assert seen == [Kind.BUMP, Kind.BUMP, Kind.BUMP, Kind.DEBRIS]


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


def test_pieces_of_one_hole_in_one_report_are_one_obstacle() -> None:
    road = Road()
    decisions = road.sees("ego1", NOON, detection(), detection(10.1, 5.1, 500, 400))
    assert kinds(decisions) == ["created", "kept"]
    assert len(road.obstacles) == 1


def test_ids_follow_from_the_report() -> None:
    one, other = Road(), Road()
    sent = message(detection())
    assert one.take(sent)[0].obstacle == other.take(sent)[0].obstacle
    identifier = one.only.id
    assert (identifier.version, identifier.variant) == (7, "specified in RFC 4122")
    assert PATRAS.latitude_deg == pytest.approx(one.only.place.position.latitude_deg, abs=1e-3)
