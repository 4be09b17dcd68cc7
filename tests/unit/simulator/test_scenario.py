from __future__ import annotations

import pickle

import numpy as np
import pytest

from contract.geometry import Kind
from simulator.changes import APPEARED, GROWN, REMOVED, Change, ChangingStreet
from simulator.scenario import ScenarioPlan, scenario
from simulator.scene.terrain import Terrain, road_roughness
from simulator.streets.street import Feature, Roughness, Street, first_light_street
from simulator.streets.world_plan import WorldPlan
from simulator.streets.worlds import random_street

SEEDS = range(8)
STREETS = [random_street(seed, WorldPlan(length_m=400.0)) for seed in SEEDS]


@pytest.mark.parametrize("street", STREETS)
def test_a_random_street_carries_its_obstacles_in_its_lanes_and_clear_of_each_other(street: Street) -> None:
    assert len(street.obstacles) >= 6
    xy = np.array([(o.x_m, o.y_m) for o in street.obstacles])
    _, t = street.main.line.project(xy)
    assert np.abs(t).max() < street.main.section.half_width_m - 0.1
    for i, one in enumerate(street.obstacles):
        for other in (*street.obstacles[i + 1 :], *street.features):
            apart = np.hypot(one.x_m - other.x_m, one.y_m - other.y_m)
            assert apart > min(one.shape.reach_m, 1.0)


@pytest.mark.parametrize("street", STREETS)
def test_its_curves_and_grades_stay_within_the_plan(street: Street) -> None:
    s = np.arange(street.main.line.start_m + 2, street.main.line.end_m - 2, 1.0)
    at = street.main.line.at(s)
    assert np.abs(at.curvature_per_m).max() < 1 / 48
    assert np.abs(at.grade).max() < 0.05 * 1.6  # PCHIP is steeper between its knots, by at most 3 / 2
    assert np.abs(np.unwrap(at.heading_rad)).max() < np.radians(100)


def test_seeds_differ_and_together_they_hold_everything() -> None:
    assert len({street.obstacles[0].x_m for street in STREETS}) == len(STREETS)
    assert {o.kind for street in STREETS for o in street.obstacles} == set(Kind)
    assert {f.kind for street in STREETS for f in street.features} == set(Feature)
    assert {street.roughness for street in STREETS} == set(Roughness)
    assert any(len(street.roads) > 2 for street in STREETS)
    assert all(street.parked_cars for street in STREETS)


def test_the_same_seed_gives_the_same_street_and_scenario() -> None:
    def summary(seed: int) -> bytes:
        happening = scenario(ScenarioPlan(seed, egos=3, seconds=5.0))
        times = np.linspace(0, 5, 7)
        motions = np.concatenate([mover.motion.poses(times) for mover in happening.movers])
        return pickle.dumps((motions, happening.changing.truth(), happening.daylight.sun_light))

    assert summary(3) == summary(3)
    assert summary(3) != summary(4)


def test_egos_follow_each_other_with_start_times_of_their_own_and_stay_on_the_street() -> None:
    happening = scenario(ScenarioPlan(2, egos=3, seconds=20.0))
    starts = [ego.start_s for ego in happening.egos]
    assert starts == sorted(set(starts))
    end_s = starts[-1] + 20.0
    street = happening.changing.street
    lane = [street.main.line.project(ego.trajectory.poses(np.array([0.0, end_s]))[:, :2, 3]) for ego in happening.egos]
    assert [s[0] for s, _ in lane] == sorted((s[0] for s, _ in lane), reverse=True)
    for s, t in lane:
        assert 0 < s[0] < s[1] < street.length_m
        assert (t < 0).all()


def test_moving_things_keep_apart() -> None:
    happening = scenario(ScenarioPlan(1, egos=2, seconds=15.0))
    for time_s in np.arange(0.0, 15.0, 1.0):
        places = np.array(
            [m.motion.poses(np.array([time_s]))[0, :2, 3] for m in happening.movers if m.model.radius_m > 2]
        )
        gaps = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1)) + 99 * np.eye(len(places))
        assert gaps.min() > 2.0


def test_obstacles_change_only_between_two_egos_passes() -> None:
    for seed in SEEDS:
        happening = scenario(ScenarioPlan(seed, egos=2, seconds=15.0))
        for change in happening.changing.changes:
            placed = happening.changing.street.obstacle(change.obstacle_id)
            for ego in happening.egos:
                pose = ego.trajectory.poses(np.array([change.time_s]))[0]
                assert np.hypot(pose[0, 3] - placed.x_m, pose[1, 3] - placed.y_m) > 10.0


def test_without_traffic_or_changes_only_the_egos_move() -> None:
    happening = scenario(ScenarioPlan(1, egos=2, seconds=5.0, traffic=False, changes=False))
    assert len(happening.movers) == 2
    assert happening.changing.changes == ()


@pytest.mark.parametrize("wrong", [{"egos": 0}, {"egos": 9}, {"seconds": 0.0}, {"seconds": float("nan")}, {"seed": -1}])
def test_a_plan_that_cannot_be_driven_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="a scenario has"):
        ScenarioPlan(**wrong)  # type: ignore[arg-type]


def test_what_changes_is_in_the_street_and_in_the_truth_from_its_time_on() -> None:
    street = first_light_street(1)
    changes = (Change(5.0, 1, GROWN, 1.3), Change(7.0, 3, REMOVED), Change(9.0, 2, APPEARED))
    changing = ChangingStreet(street, changes)
    before, after = changing.at(4.9), changing.at(9.0)
    assert [o.obstacle_id for o in before.obstacles] == [1, 3, 4]
    assert after.obstacle(1).shape.footprint_area_m2 == pytest.approx(1.3 * street.obstacle(1).shape.footprint_area_m2)
    assert after.obstacle(3).filled
    assert not before.obstacle(3).filled
    rows = changing.truth()
    assert [(row.obstacle_id, row.change, row.from_s) for row in rows] == [
        (1, "initial", 0.0),
        (3, "initial", 0.0),
        (4, "initial", 0.0),
        (1, "grown", 5.0),
        (3, "removed", 7.0),
        (2, "appeared", 9.0),
    ]
    assert rows[3].area_m2 == pytest.approx(1.3 * rows[0].area_m2)
    assert rows[4].relief_m == rows[1].relief_m


@pytest.mark.parametrize("roughness", list(Roughness))
def test_the_roughness_of_a_wheel_path_is_of_its_iso_class(roughness: Roughness) -> None:
    heights = road_roughness(4, roughness)
    step_m, count = 0.05, heights.shape[0]
    frequency = np.fft.rfftfreq(count, step_m)
    density = (2 * step_m / count * np.abs(np.fft.rfft(heights[::7], axis=1)) ** 2).mean(axis=0)
    for shortest_m in (0.8, 1.6, 3.2, 6.4):
        octave = (frequency >= 0.5 / shortest_m) & (frequency < 1 / shortest_m)
        at_reference = (density[octave] * (frequency[octave] / 0.1) ** 2).mean()
        # Classes are a factor of four apart; their limits lie a factor of two from the mean.
        assert roughness.value / 1.6 < at_reference < roughness.value * 1.6


def test_the_road_of_a_street_carries_that_roughness() -> None:
    street = Street(seed=4, roughness=Roughness.B)
    x, y = np.arange(0.0, 40.0, 0.05), np.full(800, -2.0)
    rough = Terrain(street).height_at(x, y) - street.sound_height(x, y)
    drawn = road_roughness(4, Roughness.B)
    assert rough == pytest.approx(drawn[-40 % 1024, np.arange(800)], abs=1e-9)
