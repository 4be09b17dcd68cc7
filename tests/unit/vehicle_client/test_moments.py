"""Moments: what is new is told before it is passed, everything after, and again only when it differs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from contract.geometry import Kind
from detector.types import DetectedObstacle, ObstacleKind
from tests.unit.vehicle_client.making import feature, pose_at, seen, track_at
from vehicle_client.alignment import UNALIGNED, Alignment
from vehicle_client.moments import (
    ABOUT_TO_PASS_M,
    GIVEN_UP_M,
    GOOD_LN_AREA_SD,
    KNOWN_M,
    LEAST_RELIEF_M,
    MOST_REPORTS,
    PASSED_M,
    Due,
    Moment,
    after,
    due,
    has_changed,
    is_to_be_told,
    known_tracks,
    why_untold,
)
from vehicle_client.tracking import Track

NOBODY_KNOWS: frozenset[int] = frozenset()


def moments(
    *tracks: Track, known: frozenset[int] = NOBODY_KNOWS, is_placed: bool = True, at_end: bool = False
) -> dict[int, Moment]:
    """Moments by track's number, for a car at odom's origin that looks along x."""
    return {d.track.track_id: d.moment for d in due(tracks, known, np.eye(4), is_placed=is_placed, at_end=at_end)}


def passes(track: Track, sizes_m: list[float], known: frozenset[int] = NOBODY_KNOWS) -> list[tuple[Moment, bool]]:
    """What becomes of a track that the car drives past, a metre a frame, when it measures such lengths in turn."""
    said, measured = [], iter(sizes_m)
    for x_m in range(20, -20, -1):
        track = replace(track, centre_odom_m=np.array([float(x_m), 0.0, 0.0]))
        for item in due([track], known, np.eye(4), is_placed=True, at_end=False):
            obstacle = seen(length_m=next(measured))
            tells = is_to_be_told(item, obstacle)
            track = after(item, obstacle if tells else None)
            said.append((item.moment, tells))
    return said


def test_a_new_obstacle_is_told_before_it_is_passed_and_again_only_when_it_turns_out_different() -> None:
    assert passes(track_at(20, 0), [0.9, 1.0]) == [(Moment.APPROACH, True), (Moment.PASSED, False)]
    assert passes(track_at(20, 0), [0.9, 1.1]) == [(Moment.APPROACH, True), (Moment.PASSED, True)]


def test_what_the_server_knows_is_told_once_after_it_was_passed() -> None:
    assert passes(track_at(20, 0), [0.9], known=frozenset({1})) == [(Moment.PASSED, True)]


def test_what_was_hardly_seen_from_the_front_waits_until_it_was_passed() -> None:
    approach = Due(track_at(5, 0), Moment.APPROACH)
    vague = replace(seen(), ln_area_sd=GOOD_LN_AREA_SD * 1.01)
    assert not is_to_be_told(approach, vague)
    later = Due(after(approach, None), Moment.PASSED)
    assert later.track.was_approached
    assert is_to_be_told(later, vague)


def thing(
    length_m: float, width_m: float, height_m: float, kind: ObstacleKind = ObstacleKind.DEBRIS
) -> DetectedObstacle:
    return replace(seen(kind=kind, length_m=length_m, width_m=width_m), relief_m=height_m)


@pytest.mark.parametrize("size_m", [(0.24, 0.21, 0.50), (0.32, 0.22, 0.51), (0.37, 0.21, 0.51)])
def test_a_bollard_beside_the_lane_is_told_to_nobody_and_in_the_lane_it_is(size_m: tuple[float, float, float]) -> None:
    """Three of a row along a recorded drive."""
    beside, ahead = (replace(track_at(5, y, kind=ObstacleKind.DEBRIS), beside_m=y) for y in (2.2, 0.5))
    for moment in Moment:
        assert not is_to_be_told(Due(beside, moment), thing(*size_m))
        assert is_to_be_told(Due(ahead, moment), thing(*size_m))


@pytest.mark.parametrize(
    "lying",
    [
        thing(0.6, 0.6, 0.25),
        thing(0.5, 0.4, 0.35),
        thing(1.2, 0.8, 0.5),
        thing(0.2, 0.15, 0.3),
        thing(0.3, 0.2, 0.5, ObstacleKind.BUMP),
        thing(0.3, 0.2, 0.5, ObstacleKind.POTHOLE),
    ],
)
def test_what_lies_in_the_neighbouring_lane_is_told(lying: DetectedObstacle) -> None:
    neighbour = replace(track_at(5, 3.5, kind=lying.kind), beside_m=3.5)
    assert is_to_be_told(Due(neighbour, Moment.PASSED), lying)


@pytest.mark.parametrize("moment", list(Moment))
def test_what_a_pass_shows_to_be_flat_is_told_to_nobody(moment: Moment) -> None:
    """Texture of a recorded road, of which single sweeps made a bump of 4 cm."""
    flat, low = (thing(2.7, 0.7, height_m, ObstacleKind.BUMP) for height_m in (0.027, LEAST_RELIEF_M))
    bump = track_at(5, 0, kind=ObstacleKind.BUMP)
    assert why_untold(bump, flat) == "flat"
    assert not is_to_be_told(Due(bump, moment), flat)
    assert is_to_be_told(Due(bump, moment), low)


def test_what_the_searches_seldom_found_is_told_to_nobody() -> None:
    often, seldom = track_at(-13, 0), replace(track_at(-13, 0), looks=29)
    assert why_untold(often, seen()) is None
    assert why_untold(seldom, seen()) == "doubtful"
    assert not is_to_be_told(Due(seldom, Moment.PASSED), seen())


def test_what_a_drive_begins_beyond_is_told_to_nobody_and_what_a_sensor_that_looks_back_sees_is() -> None:
    """Behind the car rings lie far apart, and nothing was ever seen nearer."""
    beyond, passed = (replace(track_at(-13, 0), was_ahead=was_ahead) for was_ahead in (False, True))
    from_behind = replace(seen(), view_front=False)
    assert why_untold(beyond, from_behind) == "behind"
    assert not is_to_be_told(Due(beyond, Moment.PASSED), from_behind)
    assert is_to_be_told(Due(passed, Moment.PASSED), from_behind)


def test_tracks_are_due_once_they_are_believed_and_near_or_passed() -> None:
    tracks = (
        track_at(-PASSED_M - 0.1, 0, 1),
        replace(track_at(-PASSED_M + 0.1, 0, 2), was_approached=True),
        track_at(-20, 0, 3, sightings=2),
        replace(track_at(-20, 0, 4), was_passed=True, was_approached=True),
        track_at(ABOUT_TO_PASS_M - 0.1, 0, 5),
        track_at(ABOUT_TO_PASS_M + 0.1, 0, 6),
        track_at(-20, 0, 7, moved_m=1.5),
    )
    assert moments(*tracks) == {1: Moment.PASSED, 5: Moment.APPROACH}
    assert moments(*tracks, known=frozenset({1, 5})) == {1: Moment.PASSED}
    assert moments(*tracks, at_end=True) == dict.fromkeys((1, 2, 5, 6), Moment.END)


def test_what_is_believed_only_behind_the_car_waits_until_it_was_passed() -> None:
    assert moments(track_at(-1, 0, 1), track_at(-11, 0, 2), track_at(1, 0, 3)) == {3: Moment.APPROACH}
    assert moments(track_at(-12.1, 0, 1)) == {1: Moment.PASSED}


def test_without_a_place_in_the_world_an_obstacle_waits_for_one_as_long_as_its_hits_are_kept() -> None:
    tracks = (track_at(5, 0, 1), track_at(-PASSED_M - 1, 0, 2), track_at(-GIVEN_UP_M - 0.1, 0, 3))
    assert moments(*tracks, is_placed=False) == {3: Moment.PASSED}


def test_no_obstacle_is_told_more_than_three_times_in_a_pass() -> None:
    track = track_at(5, 0)
    for _ in range(MOST_REPORTS):
        track = after(Due(track, Moment.APPROACH), seen())
    assert moments(replace(track, was_approached=False), at_end=True) == {}
    assert moments(replace(track, was_approached=False)) == {}


sizes = st.builds(seen, length_m=st.floats(0.2, 3), width_m=st.floats(0.2, 3))


@given(sizes, sizes)
def test_change_has_no_direction(a: DetectedObstacle, b: DetectedObstacle) -> None:
    assert has_changed(a, b) is has_changed(b, a)
    assert not has_changed(a, a)


@given(sizes, st.floats(1.0, 2.0))
@example(seen(), 1.149)
@example(seen(), 1.151)
def test_a_length_changes_by_more_than_fifteen_per_cent(a: DetectedObstacle, ratio: float) -> None:
    assert has_changed(a, replace(a, length_m=a.length_m * ratio)) is (ratio > 1.15) or abs(ratio - 1.15) < 1e-9


@pytest.mark.parametrize(("moved_m", "changed"), [(0.29, False), (0.31, True)])
def test_a_place_changes_beyond_its_error(moved_m: float, changed: bool) -> None:
    sharp = seen(covariance_m2=np.diag([1e-4, 1e-4]))
    assert has_changed(sharp, replace(sharp, centre_m=sharp.centre_m + np.array([moved_m, 0, 0]))) is changed
    vague = seen(covariance_m2=np.diag([0.02, 0.02]))
    assert not has_changed(vague, replace(vague, centre_m=vague.centre_m + np.array([moved_m, 0, 0])))


def test_a_track_is_known_when_the_map_has_an_obstacle_of_its_sign_there() -> None:
    here = pose_at()
    hole = feature(east_m=20.0)
    tracks = [
        track_at(20.0 + KNOWN_M - 0.1, 0, 1),
        track_at(20.0 + KNOWN_M + 0.1, 0, 2),
        track_at(20.0, 0, 3, kind=ObstacleKind.DEBRIS),
    ]
    assert hole.properties.kind is Kind.POTHOLE
    assert known_tracks(tracks, [hole], here, UNALIGNED) == {1}
    assert known_tracks(tracks, [hole], here, Alignment(np.array([0.5, 0.0]), 1)) == {1, 2}
    assert known_tracks(tracks, [], here, UNALIGNED) == frozenset()
