"""Tracks: one obstacle over many frames is one, and two stay two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detector.types import DetectedObstacle, ObstacleKind
from tests.unit.vehicle_client.making import planar, seen
from vehicle_client.frames import apply, inverse
from vehicle_client.tracking import (
    CONFIRMED_AFTER,
    FORGET_M,
    GATE_M,
    LEAST_SHARE,
    LOOKED_FROM_M,
    MOST_SEARCHES,
    SURE_AFTER,
    Tracks,
    update,
)

POTHOLE, BUMP, DEBRIS = ObstacleKind


def approached(
    places: Sequence[tuple[float, float, ObstacleKind]], frames: int = 15, noise_m: float = 0.0, seed: int = 0
) -> Tracks:
    """Tracks after a drive along x in `odom` towards obstacles that stand in `odom`, a metre a frame, turning a bit."""
    random = np.random.default_rng(seed)
    tracks = Tracks()
    for number in range(frames):
        odom_from_sensor = planar(number, 0.0, 0.02 * number, 1.7)
        detected = []
        for x_m, y_m, kind in places:
            place = apply(inverse(odom_from_sensor), np.array([x_m, y_m, 0.0]))
            x, y = place[:2] + random.normal(0, noise_m, 2)
            detected.append(seen(x, y, kind, z_m=place[2], yaw_rad=(0.3 - 0.02 * number) % np.pi))
        tracks = update(tracks, detected, odom_from_sensor, number / 10)
    return tracks


@pytest.mark.parametrize("seed", range(5))
def test_one_obstacle_over_many_frames_is_one_track_at_its_place(seed: int) -> None:
    (track,) = approached([(25.0, 1.0, POTHOLE)], noise_m=0.1, seed=seed).tracks
    assert track.sightings == 15
    assert track.confirmed
    assert track.centre_odom_m[:2] == pytest.approx([25.0, 1.0], abs=0.25)
    assert track.first_range_m == pytest.approx(np.hypot(25, 1), abs=0.4)
    assert track.yaw_rad == pytest.approx(0.3)


@pytest.mark.parametrize("seed", range(5))
def test_two_holes_two_metres_apart_stay_two(seed: int) -> None:
    tracks = approached([(25.0, 0.0, POTHOLE), (27.0, 0.0, POTHOLE)], noise_m=0.1, seed=seed).tracks
    assert [track.sightings for track in tracks] == [15, 15]
    assert sorted(track.centre_odom_m[0] for track in tracks) == pytest.approx([25, 27], abs=0.3)


def test_a_hole_and_a_bump_at_one_place_are_two() -> None:
    tracks = approached([(25.0, 0.0, POTHOLE), (25.2, 0.0, BUMP)]).tracks
    assert [(track.kind, track.sightings) for track in tracks] == [(POTHOLE, 15), (BUMP, 15)]


def test_a_track_is_believed_after_some_sightings_and_not_before() -> None:
    for frames in range(1, 6):
        (track,) = approached([(25.0, 0.0, DEBRIS)], frames).tracks
        assert track.confirmed == (frames >= CONFIRMED_AFTER)


@pytest.mark.parametrize(
    ("kinds", "voted"),
    [([DEBRIS, BUMP, DEBRIS], DEBRIS), ([DEBRIS, BUMP, BUMP], BUMP), ([BUMP, DEBRIS], BUMP), ([POTHOLE], POTHOLE)],
)
def test_the_kind_is_what_most_frames_took_it_for(kinds: list[ObstacleKind], voted: ObstacleKind) -> None:
    tracks = Tracks()
    for number, kind in enumerate(kinds):
        tracks = update(tracks, [seen(10, 0, kind)], np.eye(4), float(number))
    (track,) = tracks.tracks
    assert track.kind is voted


@pytest.mark.parametrize("y_m", [-3.0, 0.4, 2.5])
def test_a_track_knows_how_far_beside_the_car_it_was_passed_however_the_car_turns_afterwards(y_m: float) -> None:
    tracks = Tracks()
    for number in range(20):
        odom_from_sensor = planar(number, 0.0, 0.0 if number <= 10 else 0.1 * (number - 10), 1.7)
        place = apply(inverse(odom_from_sensor), np.array([10.0, y_m, 0.0]))
        detected = [seen(place[0], place[1], DEBRIS)] if number in (4, 5, 15) else []
        tracks = update(tracks, detected, odom_from_sensor, number / 10)
    assert tracks.tracks[0].beside_m == pytest.approx(abs(y_m), abs=0.05)


def test_what_lies_far_behind_is_dropped_and_its_number_is_not_given_again() -> None:
    tracks = update(Tracks(), [seen(10, 0)], np.eye(4), 0.0)
    assert len(update(tracks, [], planar(10 + FORGET_M - 0.1, 0, 0.0), 1.0).tracks) == 1
    dropped = update(tracks, [], planar(10 + FORGET_M + 0.1, 0, 0.0), 1.0)
    assert dropped.tracks == ()
    assert [track.track_id for track in update(dropped, [seen(10, 0)], planar(60, 0, 0.0), 2.0).tracks] == [2]


def test_a_frame_that_comes_twice_makes_no_second_track() -> None:
    tracks = update(Tracks(), [seen(10, 0), seen(14, 0)], np.eye(4), 1.0)
    assert len(update(tracks, [seen(10, 0), seen(14, 0)], np.eye(4), 1.0).tracks) == 2


def test_a_detection_without_a_place_is_nothing() -> None:
    assert update(Tracks(), [seen(np.nan, 0)], np.eye(4), 1.0).tracks == ()


@pytest.mark.parametrize("seed", range(5))
def test_what_stands_is_static_however_its_centre_wanders(seed: int) -> None:
    (track,) = approached([(20.0, 1.0, DEBRIS)], noise_m=0.3, seed=seed).tracks
    assert track.is_static


@given(st.floats(1.0, 40.0), st.booleans())
def test_what_walks_or_drives_is_never_believed_to_stand(speed_mps: float, across: bool) -> None:
    tracks = Tracks()
    for number in range(20):
        moved_m = speed_mps * number / 10
        place = (20.0, -3.0 + moved_m) if across else (20.0 + moved_m, 0.0)
        tracks = update(tracks, [seen(*place, DEBRIS)], planar(0.0, 0.0, 0.0), number / 10)
    assert not [track for track in tracks.tracks if track.confirmed and track.is_static]


def test_a_track_in_a_new_value_takes_the_old_one_s_place() -> None:
    tracks = approached([(20.0, 0.0, POTHOLE), (25.0, 0.0, POTHOLE)])
    marked = tracks.with_track(replace(tracks.tracks[1], was_passed=True))
    again = update(marked, [seen(10, 0)], planar(15.0, 0.0, 0.0), 9.0)
    assert {track.track_id: track.was_passed for track in again.tracks} == {1: False, 2: True}


sights = st.lists(st.builds(seen, st.floats(5, 12), st.floats(-3, 3), st.sampled_from(ObstacleKind)), max_size=8)


@settings(max_examples=60, deadline=None)
@given(st.lists(sights, min_size=1, max_size=4))
def test_every_detection_joins_exactly_one_track_and_no_track_takes_two_of_a_frame(
    frames: list[list[DetectedObstacle]],
) -> None:
    tracks = Tracks()
    for number, detected in enumerate(frames):
        after = update(tracks, detected, np.eye(4), float(number))
        before = {track.track_id: track.sightings for track in tracks.tracks}
        gained = [track.sightings - before.get(track.track_id, 0) for track in after.tracks]
        assert set(gained) <= {0, 1}
        assert sum(gained) == len(detected)
        tracks = after


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_tracking_is_deterministic_and_no_order_of_detections_matters(seed: int) -> None:
    random = np.random.default_rng(seed)
    one, same, other = Tracks(), Tracks(), Tracks()
    for number in range(3):
        places = random.uniform((5, -3), (12, 3), (random.integers(8), 2))
        detected = [seen(x, y, list(ObstacleKind)[random.integers(3)]) for x, y in places]
        shuffled = [detected[i] for i in random.permutation(len(detected))]
        one, same = (update(state, detected, np.eye(4), float(number)) for state in (one, same))
        other = update(other, shuffled, np.eye(4), float(number))
    assert described(one) == described(same)
    assert sorted(row[1:] for row in described(one)) == sorted(row[1:] for row in described(other))


def described(tracks: Tracks) -> list[tuple[int, float, float, str, int]]:
    return [(t.track_id, *t.centre_odom_m[:2].tolist(), t.kind.value, t.sightings) for t in tracks.tracks]


@given(st.floats(0, 3))
def test_a_detection_joins_within_the_gate_only(apart_m: float) -> None:
    tracks = update(Tracks(), [seen(10, 0)], np.eye(4), 0.0)
    after = update(tracks, [seen(10 + apart_m, 0)], np.eye(4), 0.1)
    assert len(after.tracks) == (1 if (10 + apart_m) - 10 < GATE_M else 2)


def test_a_second_hole_two_metres_on_is_its_own_also_when_it_is_seen_later() -> None:
    tracks = update(Tracks(), [seen(10, 0)], np.eye(4), 0.0)
    assert len(update(tracks, [seen(12, 0)], np.eye(4), 0.1).tracks) == 2


def passed(found_at_m: Sequence[float], place_m: float = 30.0, end_m: float = 60.0) -> Tracks:
    """Tracks after a drive along x past a hole, a metre a search, that was found only from those places."""
    tracks = Tracks()
    for x_m in np.arange(0.0, end_m):
        detected = [seen(place_m - x_m, 0.0, POTHOLE)] if x_m in found_at_m else []
        tracks = update(tracks, detected, planar(x_m, 0.0, 0.0), x_m / 10)
    return tracks


@given(st.sets(st.integers(0, 45), min_size=1, max_size=46))
def test_a_track_counts_the_searches_from_near_it_whether_they_found_it_or_not(found_at_m: set[int]) -> None:
    (track,) = passed([float(x_m) for x_m in found_at_m]).tracks
    assert track.looks == 2 * LOOKED_FROM_M + 1
    assert track.sightings == len(found_at_m)
    assert track.is_doubtful == (len(found_at_m) < LEAST_SHARE * track.looks and len(found_at_m) < SURE_AFTER)


def test_what_is_found_by_chance_now_and_then_is_believed_and_doubtful_and_what_is_found_often_is_not() -> None:
    (by_chance,) = passed([28.0, 33.0, 34.0]).tracks
    assert by_chance.confirmed
    assert by_chance.is_doubtful
    (there,) = passed([22.0, 25.0, 34.0, 35.0]).tracks
    assert not there.is_doubtful


def test_what_was_seen_often_stays_believed_however_long_the_car_goes_round_it() -> None:
    tracks = Tracks()
    for number, angle_rad in enumerate(np.arange(0.0, 20.0, 0.06)):
        x_m, y_m = 5 * np.cos(angle_rad), 5 * np.sin(angle_rad)
        found = [seen(0.0, 5.0, POTHOLE)] if number < SURE_AFTER else []
        tracks = update(tracks, found, planar(x_m, y_m, angle_rad + np.pi / 2), number / 10)
    (track,) = tracks.tracks
    assert track.looks > 300
    assert not track.is_doubtful
    assert len(tracks.searches) <= MOST_SEARCHES


@pytest.mark.parametrize(("begins_m", "was_ahead"), [(0.0, True), (29.0, True), (31.0, False)])
def test_a_track_knows_whether_it_ever_lay_ahead_also_if_it_was_only_seen_from_behind_it(
    begins_m: float, was_ahead: bool
) -> None:
    tracks = Tracks()
    for x_m in np.arange(begins_m, 45.0):
        detected = [seen(30.0 - x_m, 0.0, POTHOLE)] if x_m > 33.0 else []
        tracks = update(tracks, detected, planar(x_m, 0.0, 0.0), x_m / 10)
    assert [track.was_ahead for track in tracks.tracks] == [was_ahead]


def test_searches_are_forgotten_with_the_road_behind() -> None:
    tracks = passed([20.0], end_m=1000.0)
    assert len(tracks.searches) <= FORGET_M + 1
    assert not tracks.tracks
