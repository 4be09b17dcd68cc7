"""Passes against the truth: streets, drives, what is kept of them, and the figures that are made of it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from contract.geometry import Kind
from detector.passes.accumulator import PlaceHits
from detector.passes.inspection import KnownPlace
from detector.types import DetectedObstacle, ObstacleKind, ShapeDescriptor
from evaluation.passes_descriptors import descriptor_figures
from evaluation.passes_drive import POSE_NOISE_M, SENSORS, Pass, accumulated, looks_of_pass, plan_passes
from evaluation.passes_inspections import Verdict, sight_shares, verdict_figures, verdicts_of
from evaluation.passes_run import Plan, run
from evaluation.passes_sizes import (
    FRONT,
    FRONT_AND_REAR,
    SIZED,
    Measured,
    Truth,
    before_passing,
    beyond,
    every_nth,
    honesty_figures,
    measured_of,
    repeat_figures,
    size_figures,
)
from evaluation.passes_street import (
    HOLE_SIZES,
    TUNING_SEEDS,
    VERIFICATION_SEEDS,
    hiding_street,
    hole_size,
    passes_street,
    random_street,
)
from evaluation.passes_tables import tables
from headsup.cli import app
from simulator.fingerprint import plain
from simulator.streets.street import Street
from simulator.world import World

TRUTH = Truth(0.9, 0.7, 0.15, 0.05, 0.9, 0.7)
BOX = DetectedObstacle(
    kind=ObstacleKind.POTHOLE,
    centre_m=np.zeros(3),
    length_m=0.9,
    width_m=0.7,
    yaw_rad=0.0,
    relief_m=0.15,
    volume_m3=0.05,
    confidence=0.9,
    hits=100,
    frames=20,
    least_range_m=4.0,
    view_front=True,
    view_rear=True,
    ln_length_sd=0.04,
    ln_width_sd=0.04,
    ln_area_sd=0.02,
    relief_sd_m=0.01,
    centre_covariance_m2=np.eye(2),
    descriptor=ShapeDescriptor("shape", 2, {"area_m2": 0.5}),
    points_m=np.zeros((0, 3), dtype=np.float32),
)


def row(box: DetectedObstacle | None, obstacle_id: int = 1, size: str = "L") -> Measured:
    return Measured(101, SIZED, "paper", 30.0, 1, True, obstacle_id, size, FRONT_AND_REAR, 1, TRUTH, box)


def only(street: Street, *obstacle_ids: int) -> Street:
    return replace(street, obstacles=tuple(o for o in street.obstacles if o.obstacle_id in obstacle_ids))


def frames_at(*x_m: float) -> PlaceHits:
    """One hit at the middle of the window from each place along x."""
    origins = np.array([[x, 0.0, 2.0] for x in x_m])
    return PlaceHits(np.arange(3.0 * len(x_m)).reshape(-1, 3), np.arange(len(x_m)), origins, np.zeros(2), 1.5)


def test_no_street_of_the_printed_figures_was_used_for_tuning() -> None:
    assert not set(TUNING_SEEDS) & set(VERIFICATION_SEEDS)


@pytest.mark.parametrize("make", [passes_street, random_street, hiding_street])
def test_a_seed_makes_one_street_and_another_makes_another(make) -> None:  # type: ignore[no-untyped-def]  # any maker
    one, again, other = (plain((s.obstacles, s.parked_cars)) for s in (make(7), make(7), make(8)))
    assert one == again
    assert one != other


def test_obstacles_lie_in_lanes_with_room_around_and_holes_have_exactly_their_sizes() -> None:
    street = passes_street(5)
    x = [o.x_m for o in street.obstacles]
    assert np.diff(x).min() > 5.5
    assert all(0.5 < abs(o.y_m) < 3.0 for o in street.obstacles)
    for placed in street.obstacles:
        if (size := hole_size(placed)) is not None:
            shape = placed.shape
            assert (shape.length_m, shape.width_m, shape.relief_m) == pytest.approx(HOLE_SIZES[size], abs=0.011)
    assert sum(hole_size(o) is not None for o in street.obstacles) == 9


def test_passes_go_both_ways_at_every_speed_with_every_sensor() -> None:
    passes = plan_passes(5, ("paper", "carla"), (30.0, 50.0))
    ways = {(p.sensor, p.speed_kmh, p.direction) for p in passes}
    assert ways == {(s, v, d) for s in ("paper", "carla") for v in (30.0, 50.0) for d in (1, -1)}
    assert plan_passes(5, ("paper",)) == plan_passes(5, ("paper",))
    assert len({p.seed for p in passes}) == len(passes)


@given(st.lists(st.floats(-12, 12), min_size=1, max_size=12), st.integers(1, 5))
def test_fewer_sweeps_keep_their_hits_and_are_numbered_from_zero(x_m: list[float], every: int) -> None:
    hits = frames_at(*x_m)
    kept = every_nth(hits, every)
    assert kept.frame.tolist() == list(range(len(x_m[::every])))
    assert kept.points_m.tolist() == hits.points_m[::every].tolist()
    assert kept.origins_m.tolist() == hits.origins_m[::every].tolist()


def test_before_passing_and_from_afar_are_told_by_the_sensors_place() -> None:
    hits = frames_at(-12.0, -6.0, -1.0, 2.0, 11.0)
    assert before_passing(hits).origins_m[:, 0].tolist() == [-12.0, -6.0, -1.0]
    assert beyond(hits, 10.0).origins_m[:, 0].tolist() == [-12.0, 11.0]
    assert before_passing(frames_at()).frames == 0


def test_sizes_are_right_within_ten_per_cent_or_five_centimetres() -> None:
    rows = [row(replace(BOX, length_m=length)) for length in (0.82, 0.98, 0.78, 1.0)] + [row(None)]
    figures = size_figures(rows)
    assert (figures["passes"], figures["measured"]) == (5, 4)
    assert figures["length_right"] == 50.0
    assert figures["width_right"] == 100.0
    assert size_figures([row(None)]) == {"passes": 1, "measured": 0}


def test_an_honest_standard_deviation_holds_two_thirds_of_errors() -> None:
    rng = np.random.default_rng(3)
    rows = [row(replace(BOX, length_m=0.9 * math.exp(rng.normal(0, 0.04)))) for _ in range(2000)]
    assert honesty_figures(rows)["length"] == pytest.approx(68.3, abs=3.0)
    assert honesty_figures(rows)["relief"] == 100.0


def test_repeatability_is_about_each_places_own_mean() -> None:
    rng = np.random.default_rng(4)
    rows = [
        row(replace(BOX, length_m=0.9 * place * math.exp(rng.normal(0, 0.03))), place)
        for place in (1, 2)
        for _ in range(900)
    ]
    assert repeat_figures(rows)["area_sd"] == pytest.approx(3.0, rel=0.1)
    assert math.isnan(repeat_figures([row(BOX)])["area_sd"])


def test_a_descriptor_that_is_closer_to_its_neighbours_is_counted() -> None:
    small, large = replace(BOX, length_m=0.4, width_m=0.3), replace(BOX, length_m=0.88)
    told = [row(BOX, 1), row(large, 1), row(small, 2), row(small, 2)]
    assert descriptor_figures(told) == {"pairs": 4, "neighbour": 100.0, "any": 100.0}
    confused = [row(BOX, 1), row(small, 1), row(large, 2)]
    assert descriptor_figures(confused)["neighbour"] < 100.0


def test_wrong_verdicts_are_those_against_the_truth() -> None:
    def verdict(exists: bool, outcome: str) -> Verdict:
        return Verdict(101, "paper", 30.0, True, "large", exists, "clear", outcome, "")

    made = [verdict(True, "present"), verdict(True, "absent"), verdict(False, "absent"), verdict(False, "not_visible")]
    assert verdict_figures(made) == {
        "places": 4,
        "judged": 75.0,
        "absent": 50.0,
        "wrong_absent": 25.0,
        "wrong_present": 0.0,
    }


def test_a_car_in_between_hides_a_place_and_an_empty_road_does_not() -> None:
    street = hiding_street(3)
    placed, car = street.obstacles[0], street.parked_cars[0]
    place = KnownPlace(np.array([car.x_m, placed.y_m, 0.0]), 0.4, 0.3, 0.0, 0.1, True, 0.05)
    beside = np.array([[car.x_m + x, 1.75, 1.7] for x in (-0.5, 0.0, 0.5)])
    assert max(sight_shares(World(street), place, beside)) < 0.1
    assert sight_shares(World(replace(street, parked_cars=())), place, beside) == (1.0, 1.0)


def test_a_pass_looks_at_every_obstacle_and_measures_a_large_hole() -> None:
    street = passes_street(6)
    hole = next(o for o in street.obstacles if hole_size(o) == "L" and o.y_m < 0)
    world = World(only(street, hole.obstacle_id))
    (look,) = looks_of_pass(world, Pass("paper", 50.0, 1, 0.2, 3))
    views = {m.view: m for m in measured_of(look, SIZED) if m.every == 1}
    for view in (FRONT_AND_REAR, FRONT):
        found = views[view].measured
        assert found is not None
        assert found.length_m == pytest.approx(0.9, rel=0.12)
        assert found.relief_m == pytest.approx(0.15, rel=0.18)
    clear, sparse = verdicts_of(world, look)
    assert (clear.sight, clear.outcome, clear.exists) == ("clear", "present", True)
    assert sparse.outcome != "absent"


def test_sweeps_of_a_rolling_sensor_are_put_together_as_at_one_moment() -> None:
    street = only(passes_street(6), next(o.obstacle_id for o in passes_street(6).obstacles if o.kind is Kind.DEBRIS))
    placed = street.obstacles[0]
    drive = Pass("hdl64", 50.0, 1, 0.0, 3)
    state = next(state for along, state in accumulated(World(street), drive) if along > placed.x_m - 6.0)
    assert SENSORS["hdl64"]().rolling
    keyframe = state.keyframes[-1]
    points = keyframe.offsets_m + keyframe.origin_odom_m
    near = np.hypot(points[:, 0] - placed.x_m, points[:, 1] - placed.y_m) < placed.shape.reach_m + 0.6
    high = points[near & (points[:, 2] > 0.08)]
    # A turn takes 1.4 m of driving; uncorrected, hits ahead would lie half of that off.
    reach = placed.shape.reach_m + 4 * POSE_NOISE_M + 0.15
    assert len(high) > 10
    assert np.median(np.hypot(high[:, 0] - placed.x_m, high[:, 1] - placed.y_m)) < reach
    assert np.abs(np.median(high[:, 0]) - placed.x_m) < 0.35


def test_the_command_says_what_is_wrong_with_its_options() -> None:
    for options, complaint in (
        (["--seeds", "one"], "--seeds are whole numbers, --speeds numbers, both with commas, such as 101,102"),
        (["--speeds", "500"], "--seeds are not negative, --speeds from 5 to 130 km/h"),
        (["--sensors", "radar"], "--sensors radar: known are hdl64, paper, carla"),
    ):
        answer = CliRunner().invoke(app, ["evaluate", "passes", *options])
        assert answer.exit_code == 1
        assert complaint in answer.output


@pytest.mark.soak
def test_on_an_unseen_street_the_papers_sensor_keeps_what_the_docs_state() -> None:
    figures = tables(run(Plan(VERIFICATION_SEEDS[:1], ("paper",), (50.0,)), lambda _: None))
    sizes = {(r["street"], r["view"], r["obstacle"]): r for r in figures["size"]}
    for size in ("M", "L"):
        assert sizes[SIZED, FRONT_AND_REAR, size]["relief_right"] >= 85.0
        assert sizes[SIZED, FRONT_AND_REAR, size]["measured"] == sizes[SIZED, FRONT_AND_REAR, size]["passes"]
    for verdicts in figures["inspection"]:
        assert verdicts["wrong_absent"] <= 1.0
        assert verdicts["sight"] != "hidden" or verdicts["absent"] == 0.0
