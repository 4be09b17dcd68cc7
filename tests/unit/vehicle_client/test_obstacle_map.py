"""The map around the car: the latest revision wins, and what is gone stays gone."""

from __future__ import annotations

from datetime import timedelta
from uuid import UUID

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.events import Appeared, Left, Removed, Updated
from contract.geometry import LatLon
from tests.unit.vehicle_client.making import NOON_S, ORIGIN, PATRAS, feature, map_of, pose_at
from vehicle_client.area import Area, Heard, Reached, Strip, Surveyed
from vehicle_client.obstacle_map import (
    FRESH_FOR_S,
    MOST_REMEMBERED,
    MOST_TOMBSTONES,
    NEAR_M,
    REMEMBERED_S,
    ObstacleMap,
    apply,
    around,
    drop_expired,
    place_in_vehicle,
)


def appeared(number: int, revision: int = 1) -> Appeared:
    return Appeared(position_seq=1, obstacle=feature(number, revision=revision))


def updated(number: int, revision: int) -> Updated:
    return Updated(position_seq=1, obstacle=feature(number, revision=revision))


def removed(number: int, revision: int) -> Removed:
    return Removed(position_seq=1, obstacle_id=UUID(int=number), revision=revision, reason="absent")


def snapshot(*numbers_and_revisions: tuple[int, int], radius_m: float = 600.0) -> Surveyed:
    features = tuple(feature(number, revision=revision) for number, revision in numbers_and_revisions)
    return Surveyed(Area(PATRAS, radius_m), features)


def after(*messages: Heard, known: ObstacleMap | None = None) -> ObstacleMap:
    known = known or ObstacleMap()
    for message in messages:
        known = apply(known, message, NOON_S)
    return known


def revisions(known: ObstacleMap) -> dict[int, int]:
    return {key.int: entry.feature.properties.revision for key, entry in known.obstacles.items()}


@pytest.mark.parametrize("late", [appeared(1, 2), updated(1, 2), appeared(1, 3), snapshot((1, 2))])
def test_an_older_or_equal_revision_changes_nothing(late: Heard) -> None:
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
def test_the_order_of_messages_about_different_obstacles_does_not_matter(messages: list[Heard]) -> None:
    assert revisions(after(*messages)) == {1: 2, 3: 7}


@given(st.permutations([appeared(1, 1), updated(1, 2), updated(1, 3), snapshot((1, 3)), removed(1, 4)]))
def test_a_removed_obstacle_never_comes_back(messages: list[Heard]) -> None:
    known = after(*messages)
    assert revisions(known) == {}
    for late in messages:
        assert revisions(apply(known, late, NOON_S)) == {}


def test_a_snapshot_is_all_there_is() -> None:
    known = after(appeared(1), appeared(2), snapshot((2, 5), (3, 1)))
    assert revisions(known) == {2: 5, 3: 1}
    assert revisions(after(snapshot(), known=known)) == {}


def far(number: int, east_m: float, lives: timedelta = timedelta(days=60)) -> Appeared:
    return Appeared(position_seq=1, obstacle=feature(number, east_m, lives=lives))


def vouched(known: ObstacleMap) -> dict[int, bool]:
    return {i.int: entry.unvouched_s is None for i, entry in (known.obstacles | known.remembered).items()}


def place(east_m: float) -> LatLon:
    return ORIGIN.geodetic(np.array([east_m, 0.0, 0.0]))[0]


def test_what_left_the_area_is_kept_until_the_server_speaks_of_its_place_again() -> None:
    left = Left(position_seq=2, obstacle_id=UUID(int=1))
    known = after(far(1, 700.0), far(2, 10.0), left)
    assert vouched(known) == {1: False, 2: True}
    assert vouched(after(Reached(Area(PATRAS, 600.0)), known=known)) == {1: False, 2: True}
    assert vouched(after(Reached(Area(place(500), 600.0)), known=known)) == {2: True}
    assert vouched(after(far(1, 700.0), Reached(Area(place(500), 600.0)), known=known)) == {1: True, 2: True}
    assert after(left, removed(9, 2), known=known).obstacles == known.obstacles


def test_a_snapshot_clears_its_area_and_keeps_what_lies_outside() -> None:
    known = after(far(1, 100.0), far(2, 700.0))
    surveyed = after(Surveyed(Area(PATRAS, 600.0), ()), known=known)
    assert vouched(surveyed) == {2: False}
    ahead = Surveyed(Area(place(50), 1000.0, Strip(np.pi / 2, 500.0)), (feature(3, 300.0),))
    assert vouched(after(far(4, -20.0), ahead, known=surveyed)) == {3: True, 4: False}


def test_what_is_kept_says_since_when_nobody_vouches_for_it() -> None:
    known = apply(after(far(1, 700.0)), Reached(Area(PATRAS, 600.0)), NOON_S + 50)
    known = apply(known, Surveyed(Area(PATRAS, 600.0), ()), NOON_S + 100)
    (entry,) = known.obstacles.values()
    assert (entry.told_s, entry.unvouched_s) == (NOON_S, NOON_S + 50)


def test_near_and_far_are_sorted_as_the_car_moves_on() -> None:
    known = around(after(far(1, 0.0), far(2, NEAR_M + 900)), PATRAS, NOON_S)
    assert revisions(known) == {1: 1}
    assert around(known, place(50), NOON_S) is known
    moved = around(known, place(1_000), NOON_S)
    assert revisions(moved) == {2: 1}
    assert [i.int for i in moved.remembered] == [1]
    assert after(removed(1, 2), known=moved).remembered == {}
    assert revisions(around(after(removed(1, 2), known=moved), PATRAS, NOON_S)) == {}


def test_a_map_that_is_too_old_is_forgotten() -> None:
    known = apply(after(far(1, 700.0)), Surveyed(Area(PATRAS, 600.0), (feature(2, 5.0),)), NOON_S)
    old_s = NOON_S + REMEMBERED_S
    assert vouched(around(known, PATRAS, old_s)) == {1: False, 2: True}
    assert vouched(around(known, PATRAS, old_s + 1)) == {2: True}
    assert vouched(drop_expired(known, old_s + 1)) == {2: True}


def test_a_day_s_drive_takes_bounded_memory_and_keeps_the_nearest() -> None:
    known = ObstacleMap()
    count = MOST_REMEMBERED // 500 + 3
    for step in range(count):
        here = place(step * 2_000.0)
        one = feature(east_m=step * 2_000.0)
        found = tuple(one.model_copy(update={"id": UUID(int=1000 * step + n)}) for n in range(500))
        known = around(apply(known, Surveyed(Area(here, 600.0), found), NOON_S), here, NOON_S)
    assert len(known.remembered) == MOST_REMEMBERED
    assert len(known.obstacles) == 500
    assert min(i.int // 1000 for i in known.remembered) == 2
    for n in range(2 * MOST_TOMBSTONES):
        known = apply(known, removed(n, 2), NOON_S)
    assert len(known.removed_revisions) == MOST_TOMBSTONES
    assert UUID(int=2 * MOST_TOMBSTONES - 1) in known.removed_revisions


def test_messages_leave_the_map_they_are_applied_to_as_it_was() -> None:
    known = after(appeared(1))
    after(appeared(2), removed(1, 2), known=known)
    assert revisions(known) == {1: 1}
    with pytest.raises(TypeError):
        known.obstacles[UUID(int=5)] = known.obstacles[UUID(int=1)]  # type: ignore[index]  # that it is refused is the test


def test_the_map_is_fresh_as_long_as_the_server_speaks() -> None:
    assert not ObstacleMap().is_fresh(NOON_S)
    known = after(snapshot())
    assert known.is_fresh(NOON_S + FRESH_FOR_S)
    assert not known.is_fresh(NOON_S + FRESH_FOR_S + 0.1)
    assert apply(known, Reached(Area(PATRAS, 600.0)), NOON_S + 30).is_fresh(NOON_S + 35)


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
