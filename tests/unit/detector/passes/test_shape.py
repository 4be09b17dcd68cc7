"""The box of one pass: right, and the same from pass to pass."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detector.passes.accumulator import RESIDUAL_BAND_M, PlaceHits
from detector.passes.shape import jackknife_covariance, measure, views
from detector.types import DetectedObstacle, ObstacleKind
from tests.unit.detector.scenes import Block, Hole, Street
from tests.unit.detector.sweeps_of_a_pass import FRONT_ONLY, hits_of_pass

LARGE = Hole(0.0, 0.5, 0.9, 0.7, 0.12, 0.3)
MEDIUM = Hole(0.0, 0.5, 0.6, 0.45, 0.10, 0.3)


def measured(street: Street, is_negative: bool, seed: int, **given) -> DetectedObstacle:  # type: ignore[no-untyped-def]
    obstacle = measure(hits_of_pass(street, 0.0, 0.5, -1.5 + seed % 2, seed, **given), is_negative)
    assert obstacle is not None
    return obstacle


@pytest.mark.parametrize(("hole", "repeat"), [(LARGE, 0.03), (MEDIUM, 0.06)])
def test_the_area_of_a_holes_box_is_right_and_repeats_from_pass_to_pass(hole: Hole, repeat: float) -> None:
    boxes = [measured(Street(holes=(hole,)), True, seed) for seed in range(8)]
    areas = np.array([b.length_m * b.width_m for b in boxes])
    for measured_m, true_m in (("length_m", hole.length), ("width_m", hole.width)):
        error_m = np.abs([getattr(b, measured_m) - true_m for b in boxes])
        assert np.median(error_m) < 0.05
        assert error_m.max() < max(0.15 * true_m, 0.07)
    assert np.log(areas).std() < repeat
    assert all(b.view_front and b.view_rear for b in boxes)
    # Floors are taken to be rough, so that hits do not show their deepest place; this one is level.
    assert [b.relief_m for b in boxes] == pytest.approx([1.1 * hole.depth] * 8, rel=0.12)
    for box in boxes:
        assert box.centre_m[:2] == pytest.approx([0.0, 0.5], abs=0.02)
        assert box.kind is ObstacleKind.POTHOLE
        assert box.hits > 0
        assert len(box.points_m) <= 512


def test_the_yaw_of_an_elongated_hole_is_that_of_its_length() -> None:
    hole = measured(Street(holes=(Hole(0.0, 0.5, 1.0, 0.5, 0.12, 0.6),)), True, 3)
    assert hole.yaw_rad == pytest.approx(0.6, abs=0.06)


def test_a_hole_seen_from_the_front_only_says_so_and_is_less_sure() -> None:
    both = measured(Street(holes=(LARGE,)), True, 1)
    front = measured(Street(holes=(LARGE,)), True, 1, stretch=FRONT_ONLY)
    assert (front.view_front, front.view_rear) == (True, False)
    assert front.ln_area_sd >= 0.03 > both.ln_area_sd >= 0.018
    assert front.length_m * front.width_m == pytest.approx(0.63, rel=0.15)


def test_what_goes_on_above_the_band_that_hits_are_kept_of_is_no_obstacle_of_the_road() -> None:
    """A parked lorry's corner; a box that ends below is one."""
    for height_m, is_one in ((0.3, True), (0.5, True), (0.75, False), (2.0, False)):
        hits = hits_of_pass(Street(blocks=(Block(0.0, 0.5, 1.2, 0.8, height_m),)), 0.0, 0.5, -1.5, 2)
        road_m = np.percentile(hits.points_m[:, 2], 10)
        kept = hits.points_m[:, 2] < road_m + RESIDUAL_BAND_M[1]
        cut = replace(hits, points_m=hits.points_m[kept], frame=hits.frame[kept])
        assert (measure(cut, is_negative=False) is not None) is is_one


@pytest.mark.parametrize("stretch", [(-14.0, 14.0), FRONT_ONLY])
def test_a_box_on_the_road_is_debris_of_its_height(stretch: tuple[float, float]) -> None:
    debris = measured(Street(blocks=(Block(0.0, 0.5, 0.5, 0.35, 0.25),)), False, 2, stretch=stretch)
    assert debris.kind is ObstacleKind.DEBRIS
    assert debris.relief_m == pytest.approx(0.25, abs=0.02)
    assert debris.centre_m[:2] == pytest.approx([0.0, 0.5], abs=0.06)


def test_a_smooth_rise_is_a_bump() -> None:
    bump = measured(Street(holes=(Hole(0.0, 0.5, 0.8, 2.0, -0.09, 0.0, 1.0),)), False, 2)
    assert bump.kind is ObstacleKind.BUMP
    assert bump.relief_m == pytest.approx(0.09, abs=0.02)
    assert bump.length_m > 2 * bump.width_m


@pytest.mark.parametrize("is_negative", [True, False])
def test_there_is_nothing_to_measure_on_a_sound_road(is_negative: bool) -> None:
    for seed in range(3):
        assert measure(hits_of_pass(Street(), 0.0, 0.5, -1.5, seed), is_negative) is None


@pytest.mark.parametrize("is_negative", [True, False])
def test_too_few_hits_are_not_measured(is_negative: bool) -> None:
    hits = hits_of_pass(Street(holes=(LARGE,)), 0.0, 0.5, -1.5, 1)
    none = PlaceHits(np.empty((0, 3)), np.empty(0, dtype=np.int64), np.empty((0, 3)), hits.centre_odom_m, 1.5)
    one_frame = PlaceHits(
        hits.points_m[hits.frame == 0], hits.frame[hits.frame == 0], hits.origins_m[:1], hits.centre_odom_m, 1.5
    )
    assert measure(none, is_negative) is None
    assert measure(one_frame, is_negative) is None


@settings(max_examples=5, deadline=None)
@given(st.floats(-np.pi, np.pi), st.floats(-500, 500), st.floats(-500, 500), st.floats(-20, 20))
def test_the_measure_turns_and_moves_with_the_world(angle: float, x: float, y: float, z: float) -> None:
    hits = hits_of_pass(Street(holes=(Hole(0.0, 0.5, 1.0, 0.6, 0.12, 0.3),)), 0.0, 0.5, -1.5, 4)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
    shift = np.array([x, y, z])
    middle = turn[:2, :2] @ hits.centre_odom_m + shift[:2]
    turned = PlaceHits(hits.points_m @ turn.T + shift, hits.frame, hits.origins_m @ turn.T + shift, middle, 1.5)
    before, after = measure(hits, True), measure(turned, True)
    assert before is not None
    assert after is not None
    assert after.length_m == pytest.approx(before.length_m, rel=0.03)
    assert after.width_m == pytest.approx(before.width_m, rel=0.03)
    assert after.centre_m == pytest.approx(turn @ before.centre_m + shift, abs=0.015)
    difference = after.yaw_rad - before.yaw_rad - angle
    assert abs(np.sin(difference)) < 0.08


def test_the_same_hits_give_the_same_obstacle() -> None:
    hits = hits_of_pass(Street(holes=(LARGE,)), 0.0, 0.5, -1.5, 5)
    assert repr(measure(hits, True)) == repr(measure(hits, True))


def test_the_view_is_given_by_where_the_sensor_was() -> None:
    def seen(*x: float) -> tuple[bool, bool]:
        origins = np.array([[v, 0.0, 2.4] for v in x])
        return views(PlaceHits(np.zeros((0, 3)), np.zeros(0, dtype=np.int64), origins, np.zeros(2), 1.5))

    assert seen(-8.0, -5.0) == (True, False)
    assert seen(4.0, 8.0) == (False, True)
    assert seen(-5.0, 5.0) == (True, True)


def test_the_jackknife_of_a_mean_is_the_variance_of_the_mean() -> None:
    values = np.random.default_rng(1).normal(size=(20, 1))
    left_out = (values.sum() - values) / 19
    assert jackknife_covariance(left_out)[0, 0] == pytest.approx(values.var(ddof=1) / 20)


def with_hits(hits: PlaceHits, points_m: np.ndarray, frame: np.ndarray) -> PlaceHits:
    return PlaceHits(points_m, frame, hits.origins_m, hits.centre_odom_m, hits.half_size_m)


def test_hits_that_are_no_numbers_or_far_away_change_nothing() -> None:
    hits = hits_of_pass(Street(holes=(LARGE,)), 0.0, 0.5, -1.5, 5)
    stray = np.array([[np.nan, 0.5, 0.0], [0.1, np.inf, 0.0], [50.0, 0.5, -9.0], [0.0, -80.0, 3.0]])
    spoilt = with_hits(hits, np.concatenate([hits.points_m, stray]), np.concatenate([hits.frame, [0, 1, 2, 3]]))
    assert repr(measure(spoilt, True)) == repr(measure(hits, True))


@pytest.mark.parametrize("is_negative", [True, False])
def test_a_line_of_hits_is_not_an_obstacle(is_negative: bool) -> None:
    hits = hits_of_pass(Street(holes=(LARGE,)), 0.0, 0.5, -1.5, 1)
    x = np.linspace(-1.0, 1.0, 200)
    line = np.column_stack([hits.centre_odom_m[0] + x, np.full_like(x, hits.centre_odom_m[1]), np.zeros_like(x)])
    assert measure(with_hits(hits, line, np.arange(200) % hits.frames), is_negative) is None


def test_a_sloping_and_crowned_road_does_not_change_a_hole() -> None:
    hits = hits_of_pass(Street(holes=(LARGE,)), 0.0, 0.5, -1.5, 6)
    x, y = (hits.points_m[:, :2] - hits.centre_odom_m).T
    tilted = hits.points_m + np.column_stack([0 * x, 0 * x, 0.05 * x - 0.02 * y - 0.004 * y**2])
    level, sloping = measure(hits, True), measure(with_hits(hits, tilted, hits.frame), True)
    assert level is not None
    assert sloping is not None
    assert sloping.length_m * sloping.width_m == pytest.approx(level.length_m * level.width_m, rel=0.04)
    assert sloping.relief_m == pytest.approx(level.relief_m, abs=0.006)


def test_the_sides_and_the_depth_say_how_wrong_they_may_be() -> None:
    hole = measured(Street(holes=(LARGE,)), True, 7)
    assert 0.03 < hole.ln_length_sd < 0.1
    assert 0.03 < hole.ln_width_sd < 0.1
    assert 0.05 * hole.relief_m < hole.relief_sd_m < 0.02
    assert hole.ln_area_sd < hole.ln_length_sd


def test_the_volume_of_a_hole_is_that_of_its_form() -> None:
    hole = measured(Street(holes=(LARGE,)), True, 8)
    # Depth falls with the fourth power of the radius: 2 / 3 of the cylinder.
    assert hole.volume_m3 == pytest.approx(np.pi / 4 * 0.9 * 0.7 * 0.12 * 2 / 3, rel=0.25)
