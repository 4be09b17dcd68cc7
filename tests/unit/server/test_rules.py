"""The rule: known, changed, gone, and what must not make a difference."""

from __future__ import annotations

import math
from datetime import timedelta
from uuid import UUID

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contract.geometry import Kind
from contract.observation import DecisionKind, Detection, State
from server.life.policy import COOPERATION, PAPER, Policy
from tests.unit.server.making import HOUR, NOON, PATRAS, Road, detection, kinds, message, two_passes

policies = pytest.mark.parametrize("policy", [COOPERATION, PAPER], ids=["cooperation", "paper"])
sizes = st.tuples(st.integers(400, 3000), st.integers(400, 3000)).map(lambda pair: (max(pair), min(pair)))


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
