"""What a pass inspects: every known obstacle that it comes by, once, as it was known before."""

from __future__ import annotations

from uuid import UUID

import pytest

from tests.unit.vehicle_client.making import feature, map_of, pose_at
from vehicle_client.obstacle_map import ObstacleMap
from vehicle_client.tracking import FORGET_M
from vehicle_client.watching import INSPECTED_M, NO_WATCHES, WATCH_AHEAD_M, WATCH_BESIDE_M, due, marked_inspected, watch

ONE = UUID(int=1)


@pytest.mark.parametrize(
    ("east_m", "north_m", "is_watched"),
    [
        (WATCH_AHEAD_M - 0.1, 0, True),
        (WATCH_AHEAD_M + 0.1, 0, False),
        (-1, 0, False),
        (10, WATCH_BESIDE_M - 0.1, True),
        (10, -WATCH_BESIDE_M - 0.1, False),
    ],
)
def test_what_comes_within_range_ahead_is_watched(east_m: float, north_m: float, is_watched: bool) -> None:
    watches = watch(NO_WATCHES, map_of(feature(1, east_m=east_m, north_m=north_m)), pose_at())
    assert list(watches) == ([ONE] if is_watched else [])


def test_what_is_watched_is_due_when_it_lies_behind_and_only_once() -> None:
    known = map_of(feature(1, east_m=10), feature(2, east_m=200))
    watches = watch(NO_WATCHES, known, pose_at())
    for east_m, passed in ((9.0, []), (10 + INSPECTED_M - 0.1, []), (10 + INSPECTED_M + 0.1, [ONE])):
        here = pose_at(east_m)
        watches = watch(watches, known, here)
        assert [f.id for f in due(watches, here, at_end=False)] == passed
    watches = watch(marked_inspected(watches, [ONE]), known, here)
    assert due(watches, here, at_end=True) == []


def test_at_the_end_of_a_drive_all_that_remains_is_due() -> None:
    watches = watch(NO_WATCHES, map_of(feature(1, east_m=10), feature(2, east_m=20)), pose_at())
    assert [f.id for f in due(marked_inspected(watches, [ONE]), pose_at(), at_end=True)] == [UUID(int=2)]


def test_a_pass_is_judged_by_what_was_known_before_it() -> None:
    watches = watch(NO_WATCHES, map_of(feature(1, east_m=10)), pose_at())
    watches = watch(watches, map_of(feature(1, east_m=12, revision=2)), pose_at())
    (before,) = due(watches, pose_at(), at_end=True)
    assert before.properties.revision == 1


def test_what_the_server_took_back_is_not_inspected() -> None:
    watches = watch(NO_WATCHES, map_of(feature(1, east_m=10)), pose_at())
    assert watch(watches, ObstacleMap(), pose_at()) == {}


def test_what_is_far_behind_is_forgotten_and_inspected_again_when_the_car_comes_back() -> None:
    known = map_of(feature(1, east_m=10))
    watches = marked_inspected(watch(NO_WATCHES, known, pose_at()), [ONE])
    gone = watch(watches, known, pose_at(10 + FORGET_M + 0.1))
    assert gone == {}
    assert [f.id for f in due(watch(gone, known, pose_at()), pose_at(), at_end=True)] == [ONE]
