"""The map around the car: the latest revision wins, and what is gone stays gone."""

from __future__ import annotations

from datetime import timedelta
from uuid import UUID

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.events import Appeared, Left, Moved, Removed, ServerMessage, Snapshot, Updated
from tests.unit.vehicle_client.making import NOON_S, feature, map_of, pose_at
from vehicle_client.obstacle_map import FRESH_FOR_S, ObstacleMap, apply, drop_expired, place_in_vehicle


def appeared(number: int, revision: int = 1) -> Appeared:
    return Appeared(position_seq=1, obstacle=feature(number, revision=revision))


def updated(number: int, revision: int) -> Updated:
    return Updated(position_seq=1, obstacle=feature(number, revision=revision))


def removed(number: int, revision: int) -> Removed:
    return Removed(position_seq=1, obstacle_id=UUID(int=number), revision=revision, reason="absent")


def snapshot(*numbers_and_revisions: tuple[int, int]) -> Snapshot:
    features = tuple(feature(number, revision=revision) for number, revision in numbers_and_revisions)
    return Snapshot(position_seq=1, obstacles=features)


def after(*messages: ServerMessage, known: ObstacleMap | None = None) -> ObstacleMap:
    known = known or ObstacleMap()
    for message in messages:
        known = apply(known, message, NOON_S)
    return known


def revisions(known: ObstacleMap) -> dict[int, int]:
    return {key.int: entry.feature.properties.revision for key, entry in known.obstacles.items()}


@pytest.mark.parametrize("late", [appeared(1, 2), updated(1, 2), appeared(1, 3), snapshot((1, 2))])
def test_an_older_or_equal_revision_changes_nothing(late: ServerMessage) -> None:
    known = after(appeared(1), updated(1, 3))
    assert apply(known, late, NOON_S) == known


def test_a_newer_revision_replaces_and_keeps_when_it_was_first_told() -> None:
    known = apply(after(appeared(1)), updated(1, 2), NOON_S + 60)
    (entry,) = known.obstacles.values()
    assert (entry.feature.properties.revision, entry.told_s) == (2, NOON_S)


HISTORY = [appeared(1, 1), updated(1, 2), updated(1, 3), removed(1, 4)]


@given(st.integers(1, 4), st.data())
def test_the_order_of_messages_about_one_obstacle_does_not_matter(count: int, data: st.DataObject) -> None:
    messages = data.draw(st.permutations(HISTORY[:count]))
    assert revisions(after(*messages)) == ({} if count == 4 else {1: count})


@given(st.permutations([appeared(1), updated(1, 2), appeared(2), removed(2, 2), updated(3, 7), appeared(3, 6)]))
def test_the_order_of_messages_about_different_obstacles_does_not_matter(messages: list[ServerMessage]) -> None:
    assert revisions(after(*messages)) == {1: 2, 3: 7}


@given(st.permutations([appeared(1, 1), updated(1, 2), updated(1, 3), snapshot((1, 3)), removed(1, 4)]))
def test_a_removed_obstacle_never_comes_back(messages: list[ServerMessage]) -> None:
    known = after(*messages)
    assert revisions(known) == {}
    for late in messages:
        assert revisions(apply(known, late, NOON_S)) == {}


def test_a_snapshot_is_all_there_is() -> None:
    known = after(appeared(1), appeared(2), snapshot((2, 5), (3, 1)))
    assert revisions(known) == {2: 5, 3: 1}
    assert revisions(after(snapshot(), known=known)) == {}


def test_what_left_the_area_is_forgotten_and_may_come_again() -> None:
    left = Left(position_seq=2, obstacle_id=UUID(int=1))
    known = after(appeared(1, 4), appeared(2), left)
    assert revisions(known) == {2: 1}
    assert revisions(after(appeared(1, 4), known=known)) == {1: 4, 2: 1}
    assert revisions(after(left, removed(9, 2), known=known)) == {2: 1}


def test_messages_leave_the_map_they_are_applied_to_as_it_was() -> None:
    known = after(appeared(1))
    after(appeared(2), removed(1, 2), known=known)
    assert revisions(known) == {1: 1}
    with pytest.raises(TypeError):
        known.obstacles[UUID(int=5)] = known.obstacles[UUID(int=1)]  # type: ignore[index]


def test_the_map_is_fresh_as_long_as_the_server_speaks() -> None:
    assert not ObstacleMap().is_fresh(NOON_S)
    known = after(snapshot())
    assert known.is_fresh(NOON_S + FRESH_FOR_S)
    assert not known.is_fresh(NOON_S + FRESH_FOR_S + 0.1)
    assert apply(known, Moved(position_seq=2), NOON_S + 30).is_fresh(NOON_S + 35)


def test_what_has_expired_is_dropped() -> None:
    known = map_of(feature(1, lives=timedelta(minutes=1)), feature(2, lives=timedelta(minutes=3)))
    assert drop_expired(known, NOON_S + 59) is known
    assert revisions(drop_expired(known, NOON_S + 60)) == {2: 1}
    assert revisions(drop_expired(known, NOON_S + 600)) == {}


def test_an_obstacle_lies_where_the_car_will_meet_it() -> None:
    place = place_in_vehicle(feature(1, east_m=150.0, north_m=2.0), pose_at(100.0, 0.0))
    assert place == pytest.approx(np.array([50.0, 2.0, 0.0]), abs=0.01)


def test_a_removal_undoes_also_its_own_revision() -> None:
    assert revisions(after(appeared(1, 3), removed(1, 3), appeared(1, 3))) == {}
