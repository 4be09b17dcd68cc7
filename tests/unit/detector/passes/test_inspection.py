"""A look at a known place: present, absent or not visible; never absent where it could have been missed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detector.passes.accumulator import PlaceHits, hits_around
from detector.passes.inspection import KnownPlace, PlaceVerdict, inspect
from tests.unit.detector.scenes import Block, Hole, Street
from tests.unit.detector.sweeps_of_a_pass import FRONT_ONLY, drive_past

PLACE = KnownPlace(np.array([0.0, 0.5, 0.0]), 0.9, 0.7, 0.3, 0.12, True, 0.1)
SMALL = replace(PLACE, length_m=0.38, width_m=0.32, relief_m=0.06)
DEBRIS = replace(PLACE, length_m=0.5, width_m=0.35, yaw_rad=0.0, relief_m=0.25, is_negative=False)
HOLE = Street(holes=(Hole(0.05, 0.45, 0.9, 0.7, 0.12, 0.3),))
BOX = Street(blocks=(Block(0.0, 0.5, 0.5, 0.35, 0.25),))


def verdict_of(
    street: Street, place: KnownPlace, seed: int = 0, stretch: tuple[float, float] = (-14.0, 14.0)
) -> PlaceVerdict:
    state = drive_past(street, 0.0, 0.5, -1.5, seed, stretch)
    return inspect(hits_around(state, place.centre_odom_m[:2], place.half_size_m), place)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("stretch", [(-14.0, 14.0), FRONT_ONLY])
@pytest.mark.parametrize(("street", "place"), [(HOLE, PLACE), (BOX, DEBRIS)])
def test_what_is_still_there_is_present(
    street: Street, place: KnownPlace, stretch: tuple[float, float], seed: int
) -> None:
    assert verdict_of(street, place, seed, stretch).outcome == "present"


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("place", [PLACE, SMALL, DEBRIS])
def test_what_was_filled_or_taken_away_is_absent(place: KnownPlace, seed: int) -> None:
    verdict = verdict_of(Street(), place, seed)
    assert verdict.outcome == "absent"
    assert verdict.visible_fraction > 0.9


def test_a_hole_whose_stored_place_is_off_by_what_is_allowed_is_present() -> None:
    off = replace(PLACE, centre_odom_m=np.array([0.45, 0.1, 0.0]), place_sd_m=0.3)
    assert verdict_of(HOLE, off).outcome == "present"


def test_a_place_behind_a_parked_truck_is_not_visible() -> None:
    hidden = Street(blocks=(Block(0.0, -0.4, 12.0, 0.3, 2.0),))
    verdict = verdict_of(hidden, PLACE)
    assert verdict.outcome == "not_visible"
    assert verdict.visible_fraction < 0.5


def test_the_absence_of_a_hole_too_small_to_be_seen_is_not_claimed() -> None:
    tiny = replace(PLACE, length_m=0.25, width_m=0.2, relief_m=0.03)
    assert verdict_of(Street(), tiny).outcome == "not_visible"


def test_a_place_seen_only_from_afar_is_not_visible() -> None:
    assert verdict_of(Street(), PLACE, stretch=(-14.0, -9.5)).outcome == "not_visible"


def test_a_hole_that_became_shallow_is_neither_present_nor_absent() -> None:
    worn = Street(holes=(Hole(0.0, 0.5, 0.9, 0.7, 0.04, 0.3),))
    assert verdict_of(worn, PLACE).outcome == "not_visible"


def test_a_thing_on_the_place_of_a_filled_hole_is_not_the_hole() -> None:
    assert verdict_of(BOX, PLACE).outcome != "present"


def test_without_hits_nothing_is_visible() -> None:
    nothing = PlaceHits(np.empty((0, 3)), np.empty(0, dtype=np.int64), np.empty((0, 3)), np.zeros(2), 1.5)
    assert inspect(nothing, PLACE) == PlaceVerdict("not_visible", 0.0, "too few sweeps or hits at the place")


@settings(max_examples=5, deadline=None)
@given(st.floats(-np.pi, np.pi), st.floats(-300, 300), st.floats(-300, 300), st.sampled_from([HOLE, Street()]))
def test_a_verdict_turns_and_moves_with_the_world(angle: float, x: float, y: float, street: Street) -> None:
    state = drive_past(street, 0.0, 0.5, -1.5, 4)
    hits = hits_around(state, PLACE.centre_odom_m[:2], 2.5)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
    shift = np.array([x, y, 3.0])
    place = replace(PLACE, centre_odom_m=turn @ PLACE.centre_odom_m + shift, yaw_rad=(PLACE.yaw_rad + angle) % np.pi)
    turned = PlaceHits(
        hits.points_m @ turn.T + shift, hits.frame, hits.origins_m @ turn.T + shift, place.centre_odom_m[:2], 2.5
    )
    assert inspect(turned, place).outcome == inspect(hits, PLACE).outcome


def test_hits_that_are_no_numbers_change_no_verdict() -> None:
    hits = hits_around(drive_past(HOLE, 0.0, 0.5, -1.5, 0), PLACE.centre_odom_m[:2], PLACE.half_size_m)
    spoilt = PlaceHits(
        np.concatenate([hits.points_m, np.full((3, 3), np.nan)]),
        np.concatenate([hits.frame, [0, 1, 2]]),
        hits.origins_m,
        hits.centre_odom_m,
        hits.half_size_m,
    )
    assert inspect(spoilt, PLACE) == inspect(hits, PLACE)
