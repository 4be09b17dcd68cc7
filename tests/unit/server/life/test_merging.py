"""Two stored obstacles that turn out to be one, and two that never are."""

from __future__ import annotations

from datetime import timedelta

from hypothesis import given
from hypothesis import strategies as st

from contract.geometry import Kind
from contract.observation import State
from server.life import merging
from server.life.obstacle import Obstacle
from server.life.policy import COOPERATION
from server.rules import Aftermath
from tests.unit.server.making import HOUR, NOON, PATRAS, Road, detection, message

MATCHING = COOPERATION.matching


def doubled(apart_m: float) -> Road:
    """One hole that two vehicles with bad fixes took for two."""
    road = Road()
    road.sees("ego1", NOON, detection(0, 0), pose_sd_m=0.1)
    road.sees(
        "ego2",
        NOON + HOUR,
        detection(0, 0),
        pose_sd_m=0.1,
        position=PATRAS.model_copy(update={"latitude_deg": PATRAS.latitude_deg + apart_m / 111_000}),
    )
    return road


def test_two_that_agree_and_were_never_seen_together_merge_into_the_older() -> None:
    road = doubled(1.9)
    older, younger = sorted(road.obstacles.values(), key=lambda item: item.id)
    # Ten passes between them draw one over.
    for number in range(10):
        between = PATRAS.model_copy(update={"latitude_deg": PATRAS.latitude_deg + 0.95 / 111_000})
        road.sees(f"other{number}", NOON + (2 + number) * HOUR, detection(0, 0), pose_sd_m=0.5, position=between)
    live = [item for item in road.obstacles.values() if item.is_live]
    assert [item.id for item in live] == [older.id]
    gone = road.obstacles[younger.id]
    assert (gone.state, gone.removed_reason, gone.merged_into) == (State.REMOVED, "merged", older.id)
    assert live[0].sightings >= 3


def test_neighbours_that_one_report_saw_side_by_side_never_merge() -> None:
    road = Road()
    road.sees("ego1", NOON, detection(0, 0, 500, 400), detection(0.8, 0, 500, 400), pose_sd_m=0.1)
    a, b = road.obstacles.values()
    assert (a.distinct_from, b.distinct_from) == ({b.id}, {a.id})
    for number in range(5):
        road.sees(f"ego{number + 2}", NOON + number * HOUR, detection(0.4, 0, 500, 400), pose_sd_m=0.1)
    assert sum(item.is_live for item in road.obstacles.values()) == 2


def test_neighbours_reported_one_by_one_in_one_pass_never_merge() -> None:
    """A vehicle may report each obstacle when it has passed it."""
    road = Road()
    road.sees("ego1", NOON, detection(0, 0), pose_sd_m=0.1)
    road.sees("ego1", NOON + timedelta(seconds=5), detection(4, 0), pose_sd_m=0.1)
    a, b = road.obstacles.values()
    assert (a.distinct_from, b.distinct_from) == ({b.id}, {a.id})


def test_being_told_apart_is_not_served_and_makes_no_revision() -> None:
    road = Road()
    decisions = road.sees("ego1", NOON, detection(0, 0), detection(5, 0))
    assert [item.outcome for item in decisions[2:]] == [Aftermath.TOLD_APART] * 2
    assert {item.revision for item in road.obstacles.values()} == {1}


def test_holes_and_things_do_not_merge() -> None:
    road = Road()
    road.sees("ego1", NOON, detection(0, 0, kind=Kind.POTHOLE))
    road.sees("ego2", NOON + HOUR, detection(0, 0, kind=Kind.DEBRIS))
    assert sum(item.is_live for item in road.obstacles.values()) == 2


def test_a_merged_obstacle_does_not_supersede_what_is_seen_there_later() -> None:
    """Its place is not empty: the one that it belongs to is there."""
    gone = _pair(0.2)[1]
    merged_away = merging.merged(*_pair(0.2), MATCHING)[1]
    assert merged_away.id == gone.id
    assert merged_away.closed_until is None


@given(st.floats(0, 3), st.integers(1, 50), st.integers(1, 50), st.floats(0, 1), st.floats(0, 1))
def test_a_merge_loses_nothing_and_does_not_depend_on_the_order(
    apart_m: float, a_sightings: int, b_sightings: int, a_confidence: float, b_confidence: float
) -> None:
    a, b = _pair(apart_m)
    a = a._replace(sightings=a_sightings, confidence=a_confidence)
    b = b._replace(sightings=b_sightings, confidence=b_confidence)
    survivor, gone = merging.merged(a, b, MATCHING)
    assert merging.merged(b, a, MATCHING) == (survivor, gone)
    assert (survivor.id, gone.merged_into) == (min(a.id, b.id), min(a.id, b.id))
    assert survivor.sightings == a_sightings + b_sightings
    assert survivor.confidence == max(a_confidence, b_confidence)
    assert survivor.place.covariance.east_m2 <= min(a.place.covariance.east_m2, b.place.covariance.east_m2) + 1e-9


def test_an_inspection_after_a_merge_says_that_it_is_removed_already() -> None:
    road = Road()
    a, b = _pair(0.2)
    survivor, gone = merging.merged(a, b, MATCHING)
    road.obstacles = {survivor.id: survivor, gone.id: gone}
    assert road.misses("ego9", NOON + 9 * HOUR, gone.id).reason == "already-removed"


def _pair(apart_m: float) -> tuple[Obstacle, Obstacle]:
    one, other = Road(), Road()
    one.take(message(detection(0, 0), vehicle="ego1"))
    other.take(message(detection(0, apart_m), vehicle="ego2", at=NOON + HOUR))
    return one.only, other.only
