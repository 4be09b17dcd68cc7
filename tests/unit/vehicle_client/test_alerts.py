"""Alerts: the table of stages, and that a driver is told once, in time, and of nothing else."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from uuid import UUID

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contract.geometry import Kind
from detector.types import ObstacleKind
from tests.unit.vehicle_client.making import NOON_S, feature, map_of, pose_at, track_at
from vehicle_client.alerts import (
    CORRIDOR_M,
    MAX_DISTANCE_M,
    MIN_DISTANCE_M,
    STAGES,
    STANDSTILL_MPS,
    STAYS_M,
    TITLES,
    Alerts,
    Stage,
    choose,
    stage_at,
)
from vehicle_client.obstacle_map import ObstacleMap
from vehicle_client.tracking import Track
from vehicle_client.way_ahead import CHANGES_WITHIN_M, Bend

EAST = math.pi / 2


def told(
    known: ObstacleMap,
    tracks: tuple[Track, ...] = (),
    *,
    previous: Alerts | None = None,
    east_m: float = 0.0,
    speed_mps: float = 10.0,
    heading_rad: float = EAST,
    now_s: float = NOON_S,
) -> Alerts:
    pose = pose_at(east_m, 0.0, heading_rad, speed_mps=speed_mps)
    return choose(previous or Alerts(), known, tracks, pose, now_s)


def approach(
    known: ObstacleMap, from_m: float, speed_mps: float, frame_rate_hz: float, tracks: tuple[Track, ...] = ()
) -> list[Alerts]:
    """What the driver is told on the way from `from_m` east, a frame after the other, until 20 m after the origin."""
    frames = int((20.0 - from_m) / speed_mps * frame_rate_hz)
    shown = [Alerts()]
    for number in range(frames):
        east_m = from_m + number * speed_mps / frame_rate_hz
        shown.append(told(known, tracks, previous=shown[-1], east_m=east_m, speed_mps=speed_mps))
    return shown[1:]


def test_every_stage_has_a_row_and_rows_come_nearer() -> None:
    assert [row.stage for row in STAGES] == sorted(Stage)
    assert all(earlier.arrival_s > later.arrival_s for earlier, later in pairwise(STAGES))
    assert [row.stage for row in STAGES if row.chime] == [Stage.WARN]


@pytest.mark.parametrize("kind", Kind)
def test_every_kind_has_a_title_that_a_glance_reads(kind: Kind) -> None:
    assert 0 < len(TITLES[kind]) <= 24
    (hazard,) = told(map_of(feature(kind=kind, east_m=50))).hazards
    assert hazard.title == TITLES[kind]


@pytest.mark.parametrize("speed_mps", [8.0, 14.0, 22.0, 33.0])
@pytest.mark.parametrize("row", STAGES, ids=lambda row: row.stage.name)
def test_a_stage_begins_at_its_time_to_arrival(row: tuple[Stage, float, bool], speed_mps: float) -> None:
    stage, arrival_s, _ = row
    begins_m = min(arrival_s * speed_mps, MAX_DISTANCE_M)
    assert (stage_at(begins_m - 0.01, speed_mps) or 0) >= stage
    assert (stage_at(begins_m + 0.01, speed_mps) or 0) < stage


def test_no_stage_begins_beyond_400_m_and_a_warning_comes_no_later_than_at_30_m() -> None:
    assert stage_at(MAX_DISTANCE_M + 0.1, 70.0) is None
    assert stage_at(MAX_DISTANCE_M, 70.0) is Stage.WARN
    assert stage_at(MIN_DISTANCE_M, STANDSTILL_MPS) is Stage.WARN
    assert stage_at(5.0, STANDSTILL_MPS) is Stage.MARK


@given(st.floats(0.1, 500), st.floats(0, 500), st.floats(2, 60))
def test_nearer_is_never_less_urgent(distance_m: float, farther_m: float, speed_mps: float) -> None:
    near, far = stage_at(distance_m, speed_mps), stage_at(distance_m + farther_m, speed_mps)
    assert (near or 0) >= (far or 0)


def test_below_walking_pace_nothing_is_said() -> None:
    known = map_of(feature(east_m=20))
    alerts = told(known, (track_at(10, 0),), speed_mps=STANDSTILL_MPS - 0.01)
    assert (alerts.hazards, alerts.chime) == ((), False)
    assert len(told(known, speed_mps=STANDSTILL_MPS).hazards) == 1


@settings(max_examples=40, deadline=None)
@given(st.floats(3, 40), st.floats(2, 20), st.floats(-2, 2))
def test_an_approach_sounds_one_chime_and_no_stage_ever_falls(
    speed_mps: float, frame_rate_hz: float, beside_m: float
) -> None:
    shown = approach(map_of(feature(north_m=beside_m)), -450.0, speed_mps, frame_rate_hz)
    stages = [alerts.hazards[0].stage for alerts in shown if alerts.hazards]
    assert stages == sorted(stages)
    assert {Stage.WARN, Stage.MARK} <= set(stages)
    assert [alerts.hazards[0].stage for alerts in shown if alerts.chime] == [Stage.WARN]


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(2.1, 35), min_size=20, max_size=60))
def test_however_the_car_brakes_no_stage_falls_and_one_chime_sounds_at_most(speeds_mps: list[float]) -> None:
    known, shown, east_m = map_of(feature()), [Alerts()], -300.0
    for speed_mps in speeds_mps:
        east_m += speed_mps / 2
        if east_m < 0:
            shown.append(told(known, previous=shown[-1], east_m=east_m, speed_mps=speed_mps))
    seen = [alerts.hazards[0].stage for alerts in shown if alerts.hazards]
    first = next((n for n, alerts in enumerate(shown) if alerts.hazards), len(shown))
    assert len(seen) == len(shown) - first, "what was shown stays shown until it is passed"
    assert seen == sorted(seen)
    assert sum(alerts.chime for alerts in shown) <= 1


def test_each_of_two_obstacles_has_its_chime() -> None:
    shown = approach(map_of(feature(1, east_m=-100), feature(2, east_m=0)), -400.0, 15.0, 10.0)
    assert sum(alerts.chime for alerts in shown) == 2


def test_what_the_own_lidar_finds_first_is_not_announced_again_when_the_server_tells_of_it_or_the_two_part() -> None:
    own, known = (track_at(0, 0),), map_of(feature(east_m=0.5))
    far_off = map_of(feature(east_m=6.0))
    alerts = told(ObstacleMap(), own, east_m=-70)
    assert (alerts.chime, alerts.hazards[0].obstacle_id) == (True, None)
    for map_now in (known, far_off, known, ObstacleMap()):
        alerts = told(map_now, own, previous=alerts, east_m=-69)
        assert not alerts.chime
        assert max(hazard.stage for hazard in alerts.hazards) is Stage.WARN


def test_what_is_first_known_when_it_is_about_to_be_passed_is_marked_without_an_alarm() -> None:
    alerts = told(map_of(feature(east_m=10)), speed_mps=10.0)
    assert ([hazard.stage for hazard in alerts.hazards], alerts.chime) == ([Stage.MARK], False)


def test_a_second_approach_warns_again() -> None:
    known = map_of(feature())
    (*_, passed) = approach(known, -100.0, 10.0, 10.0)
    assert (passed.hazards, dict(passed.stages)) == ((), {})
    assert told(known, previous=passed, east_m=-70.0).chime


def test_after_a_stop_the_same_obstacle_sounds_no_second_chime() -> None:
    known = map_of(feature())
    warned = told(known, east_m=-70.0)
    waiting = told(known, previous=warned, east_m=-60.0, speed_mps=0.0)
    going = told(known, previous=waiting, east_m=-60.0)
    assert (warned.chime, waiting.chime, going.chime) == (True, False, False)
    assert going.hazards[0].stage is Stage.WARN


@pytest.mark.parametrize(
    ("east_m", "north_m"), [(-1.0, 0.0), (-40.0, 1.0), (50.0, CORRIDOR_M + 0.1), (50.0, -CORRIDOR_M - 0.1)]
)
def test_what_lies_behind_or_beside_the_way_is_not_shown(east_m: float, north_m: float) -> None:
    alerts = told(map_of(feature(east_m=east_m, north_m=north_m)), (track_at(east_m, north_m),))
    assert (alerts.hazards, alerts.chime) == ((), False)


@pytest.mark.parametrize(("beside_m", "is_shown"), [(4.0, True), (-4.0, True), (6.0, False), (-6.0, False)])
def test_what_may_lie_on_the_way_is_shown_since_neither_place_is_known_to_a_lane(
    beside_m: float, is_shown: bool
) -> None:
    # Standard deviations of 1 m for the car and 0.5 m for the obstacle: 2.5 m and twice 1.15 m.
    alerts = told(map_of(feature(east_m=50.0, north_m=beside_m)))
    assert bool(alerts.hazards) is is_shown


def test_far_ahead_a_small_error_of_the_heading_keeps_no_obstacle_from_the_driver() -> None:
    assert told(map_of(feature(east_m=160.0, north_m=5.2))).hazards
    assert not told(map_of(feature(east_m=40.0, north_m=5.2))).hazards


def test_a_place_that_wavers_over_the_edge_of_the_way_sounds_one_chime() -> None:
    alerts, chimes = Alerts(), 0
    for number in range(20):
        beside_m = CORRIDOR_M + (0.2 if number % 2 else -0.2)
        alerts = told(map_of(), (track_at(0.0, beside_m),), previous=alerts, east_m=-75.0 + number)
        chimes += alerts.chime
    assert chimes == 1


def test_an_own_track_and_the_server_s_obstacle_are_one_hazard_at_the_place_the_lidar_sees() -> None:
    (hazard,) = told(map_of(feature(7, east_m=52, north_m=1)), (track_at(50, 0, 3),)).hazards
    assert (hazard.obstacle_id, hazard.track_id, hazard.recognised) == (UUID(int=7), 3, True)
    assert hazard.centre_vehicle_m == pytest.approx([50, 0, 0], abs=0.01)


def test_signs_and_distance_keep_obstacles_apart() -> None:
    bump = track_at(50, 0, 1, kind=ObstacleKind.BUMP)
    assert len(told(map_of(feature(east_m=50.5)), (bump,)).hazards) == 2
    assert len(told(map_of(feature(east_m=54.1)), (track_at(50, 0),)).hazards) == 2


@pytest.mark.parametrize("order", [(1, 2), (2, 1)])
def test_of_two_mapped_holes_the_nearer_one_is_what_the_lidar_sees(order: tuple[int, int]) -> None:
    places = {1: 50.1, 2: 53.0}
    known = map_of(*(feature(number, east_m=places[number]) for number in order))
    hazards = told(known, (track_at(50, 0, 9),)).hazards
    assert [(h.obstacle_id, h.track_id) for h in hazards] == [(UUID(int=1), 9), (UUID(int=2), None)]


def test_a_track_that_is_not_believed_yet_is_not_shown() -> None:
    assert told(ObstacleMap(), (track_at(50, 0, sightings=2),)).hazards == ()


def test_the_nearest_hazard_comes_first() -> None:
    known = map_of(feature(1, east_m=90), feature(2, east_m=40), feature(3, east_m=60))
    distances_m = [hazard.distance_m for hazard in told(known, (track_at(50, 1),)).hazards]
    assert distances_m == pytest.approx([40, 50, 60, 90], abs=0.01)


def test_a_map_that_is_not_fresh_is_said_and_still_warns() -> None:
    known = map_of(feature(east_m=50))
    assert told(known).fresh
    old = told(known, now_s=NOON_S + 11)
    assert (old.fresh, len(old.hazards)) == (False, 1)
    assert not told(known, now_s=NOON_S + 11, speed_mps=0.0).fresh


@pytest.mark.parametrize("heading_rad", [0.0, 1.0, EAST, 4.0])
def test_the_box_is_turned_with_the_car(heading_rad: float) -> None:
    along = ((EAST - heading_rad) % math.pi, math.sin(heading_rad), math.cos(heading_rad))
    known = map_of(feature(east_m=50 * along[1], north_m=50 * along[2], yaw_rad=along[0]))
    (hazard,) = told(known, heading_rad=heading_rad).hazards
    assert math.sin(hazard.yaw_rad) == pytest.approx(0, abs=1e-9)
    assert (hazard.length_m, hazard.width_m) == (0.9, 0.7)


def test_a_hazard_is_remembered_by_all_its_names() -> None:
    (hazard,) = told(map_of(feature(7, east_m=50)), (track_at(50, 0, 3),)).hazards
    assert len({*hazard.keys, *replace(hazard, track_id=None).keys}) == 2


def test_of_a_post_beside_the_lane_the_driver_is_warned_only_if_the_server_warns() -> None:
    """As it is not reported: upright, slender, and farther than half a lane beside the car's course."""
    post = replace(track_at(30, 2.0, kind=ObstacleKind.DEBRIS), length_m=0.2, width_m=0.2, relief_m=0.8)
    nothing = map_of()
    assert told(nothing, (post,)).hazards == ()
    in_lane = replace(post, centre_odom_m=np.array([30.0, 1.5, 0.0]))
    for other in (in_lane, replace(post, relief_m=0.3), replace(post, length_m=2.0, width_m=1.0)):
        (hazard,) = told(nothing, (other,)).hazards
        assert hazard.kind is Kind.DEBRIS
    (known,) = told(map_of(feature(kind=Kind.DEBRIS, east_m=30, north_m=2)), (post,)).hazards
    assert known.recognised


LEFT_BEND = 1 / 100


def in_bend(
    known: ObstacleMap, tracks: tuple[Track, ...] = (), *, curvature_per_m: float = LEFT_BEND, sd_per_m: float = 0.0
) -> Alerts:
    """What the driver is told at 10 m/s, at the origin and towards east, on a bend to the left."""
    return choose(Alerts(), known, tracks, replace(pose_at(), bend=Bend(curvature_per_m, sd_per_m)), NOON_S)


def test_in_a_bend_the_driver_is_warned_of_what_lies_on_it() -> None:
    # 75 m of a circle of 100 m radius: 68 m ahead and 27 m to the left.
    along_rad = 0.75
    known = map_of(feature(east_m=100 * math.sin(along_rad), north_m=100 * (1 - math.cos(along_rad))))
    alerts = in_bend(known)
    (hazard,) = alerts.hazards
    assert (alerts.chime, hazard.stage) == (True, Stage.WARN)
    assert (hazard.distance_m, hazard.beside_m) == pytest.approx((75.0, 0.0), abs=0.1)
    assert hazard.arrival_s == pytest.approx(7.5, abs=0.01)
    assert in_bend(known, curvature_per_m=0.0).hazards == in_bend(known, curvature_per_m=-LEFT_BEND).hazards == ()


def test_bends_end_so_that_what_the_server_says_lies_straight_ahead_counts_too() -> None:
    assert in_bend(map_of(feature(east_m=60))).chime


def test_what_the_own_lidar_sees_on_the_outside_of_a_bend_stands_beside_the_way() -> None:
    on_bend, outside = track_at(25.0, 3.2, 1), track_at(30.0, 0.0, 2)
    hazards = in_bend(map_of(), (on_bend, outside)).hazards
    assert [h.track_id for h in hazards] == [1]
    told_as_well = in_bend(map_of(feature(east_m=30)), (on_bend, outside)).hazards
    assert [h.track_id for h in told_as_well] == [1, 2], "what the server warns of is warned of"


UNSURE = LEFT_BEND / 2
"""Of a bend that begins or ends."""


def test_while_a_bend_begins_or_ends_the_own_lidar_warns_late_rather_than_wrongly() -> None:
    """Here it leads 1.3 m farther to the left than straight on, give or take 0.6 m."""
    tracks = [track_at(16.0, y, number) for number, y in enumerate((1.3, -0.3, -1.4, -3.5), start=1)]
    for speed_mps, numbers in ((5.0, {1}), (16 / 2.5, {1, 2}), (16 / 2.0, {1, 2, 3})):
        pose = replace(pose_at(speed_mps=speed_mps), bend=Bend(LEFT_BEND, UNSURE))
        assert {h.track_id for h in choose(Alerts(), map_of(), tracks, pose, NOON_S).hazards} == numbers


@given(st.floats(0, 8), st.floats(0, 1.75), st.floats(2, 30), st.floats(0, 30))
def test_what_the_own_lidar_warns_of_at_a_distance_it_would_warn_of_nearer_by_too(
    beside_m: float, sd_m: float, near_m: float, farther_m: float
) -> None:
    def warns(ahead_m: float) -> bool:
        pose = replace(pose_at(), bend=Bend(0.0, 2 * sd_m / min(ahead_m, CHANGES_WITHIN_M) ** 2))
        return bool(choose(Alerts(), map_of(), (track_at(ahead_m, beside_m),), pose, NOON_S).hazards)

    assert warns(near_m) or not warns(near_m + farther_m)


def test_a_marker_that_is_shown_does_not_flicker_where_its_place_wavers() -> None:
    alerts = told(map_of(), (track_at(20.0, CORRIDOR_M - 0.1),))
    for beside_m in (CORRIDOR_M + 0.3, CORRIDOR_M - 0.2, CORRIDOR_M + 0.4):
        alerts = told(map_of(), (track_at(20.0, beside_m),), previous=alerts)
        assert alerts.hazards
    far = (track_at(20.0, CORRIDOR_M + STAYS_M + 0.1),)
    assert not told(map_of(), far, previous=alerts).hazards
    unsure = replace(pose_at(), bend=Bend(0.0, UNSURE))
    assert choose(alerts, map_of(), far, unsure, NOON_S).hazards, "unless nobody knows so well where the way is"
    assert not told(map_of(), (track_at(20.0, CORRIDOR_M + 0.3),)).hazards


def test_a_car_that_backs_is_not_warned_of_what_lies_in_front_of_it() -> None:
    assert told(map_of(feature(east_m=50)), (track_at(10, 0),), speed_mps=-3.0).hazards == ()


def test_a_slender_thing_that_may_stand_in_the_own_lane_is_no_post_beside_it() -> None:
    cone = replace(track_at(12.0, 2.0, kind=ObstacleKind.DEBRIS), length_m=0.3, width_m=0.3, relief_m=0.7)
    assert not in_bend(map_of(), (cone,), curvature_per_m=0.0).hazards
    announced = in_bend(map_of(), (cone,), curvature_per_m=0.0, sd_per_m=UNSURE)
    assert announced.hazards
    assert choose(announced, map_of(), (cone,), pose_at(), NOON_S).hazards, "what was announced stays so"


def test_what_turns_out_to_be_slender_does_not_vanish() -> None:
    broad = track_at(20.0, CORRIDOR_M - 0.1, kind=ObstacleKind.DEBRIS)
    slender = replace(broad, length_m=0.3, width_m=0.3, relief_m=0.7)
    assert told(map_of(), (slender,), previous=told(map_of(), (broad,))).hazards
    assert not told(map_of(), (slender,)).hazards


def test_in_a_bend_a_cone_in_the_own_lane_is_no_post_beside_it() -> None:
    cone = replace(track_at(25.0, 3.1, kind=ObstacleKind.DEBRIS), length_m=0.3, width_m=0.3, relief_m=0.7)
    assert in_bend(map_of(), (cone,)).hazards
    assert not in_bend(map_of(), (replace(cone, centre_odom_m=np.array([25.0, 1.1, 0.0])),)).hazards


def test_what_the_own_lidar_saw_on_a_bend_stays_announced_where_the_bend_ends() -> None:
    ahead = (track_at(25.0, 0.0, 1),)
    announced = choose(Alerts(), map_of(), ahead, pose_at(), NOON_S)
    after = choose(announced, map_of(), ahead, replace(pose_at(), bend=Bend(LEFT_BEND)), NOON_S)
    assert [h.track_id for h in after.hazards] == [1]
    assert not after.chime
