from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.streets.centreline import alignment
from simulator.streets.road import Road, straight_road
from simulator.streets.traffic import CAR_LENGTH_M, Driver, follow, speed_limits
from simulator.streets.trajectory import STEADY, Sway, Trajectory, lane_path

LIMIT_MPS = 13.9


def test_a_lone_car_keeps_the_limit() -> None:
    times, travelled = follow(lane_path(straight_road(800.0, 0.0), 0), [Driver(5.0)], LIMIT_MPS, 30.0)
    assert np.diff(travelled[:, 0])[50:] / np.diff(times)[50:] == pytest.approx(np.full(len(times) - 51, LIMIT_MPS))


@given(st.lists(st.tuples(st.floats(7.0, 60.0), st.floats(0.7, 1.1)), min_size=2, max_size=8))
@settings(max_examples=30, deadline=None)
def test_cars_never_touch_and_never_drive_backwards(gaps: list[tuple[float, float]]) -> None:
    starts = np.cumsum([gap for gap, _ in gaps])
    drivers = [Driver(float(at), eager) for at, (_, eager) in zip(starts, gaps, strict=True)]
    _, travelled = follow(lane_path(straight_road(1_500.0, 0.0), 0), drivers, LIMIT_MPS, 25.0)
    assert (np.diff(travelled, axis=0) >= 0).all()
    assert np.diff(travelled, axis=1).min() > CAR_LENGTH_M


def test_cars_slow_down_before_a_curve_so_that_it_stays_comfortable() -> None:
    bend = [(0.0, 0.0), (150.0, 0.0), (165.0, 1 / 30), (190.0, 1 / 30), (205.0, 0.0), (400.0, 0.0)]
    path = lane_path(Road(alignment(bend, [(0.0, 0.0)])), 0)
    along, allowed = speed_limits(path, LIMIT_MPS)
    assert allowed[along < 80].min() == pytest.approx(LIMIT_MPS)
    times, travelled = follow(path, [Driver(20.0)], LIMIT_MPS, 30.0)
    car = Trajectory(path, times, travelled[:, 0], STEADY, 0)
    moments = np.arange(0.0, 25.0, 0.1)
    lateral = car.speed(moments) ** 2 * np.abs(path.line.at(car.distance(moments)).curvature_per_m)
    assert lateral.max() < 2.6
    assert car.speed(moments).min() < 9.0


def test_cars_that_start_inside_each_other_are_refused() -> None:
    with pytest.raises(ValueError, match="apart"):
        follow(lane_path(straight_road(300.0, 0.0), 0), [Driver(10.0), Driver(13.0)], LIMIT_MPS, 5.0)


def test_the_oncoming_lane_is_driven_the_other_way_on_the_left() -> None:
    path = lane_path(straight_road(300.0, 0.0), 1)
    car = Trajectory(path, np.arange(4.0), 100.0 + 10.0 * np.arange(4.0), STEADY, 0)
    poses = car.poses(np.array([0.0, 1.0]))
    assert poses[1, :3, 3] - poses[0, :3, 3] == pytest.approx([-10.0, 0.0, 0.0], abs=1e-6)
    assert poses[0, 1, 3] == pytest.approx(1.75)
    assert poses[0, 0, 0] == pytest.approx(-1.0)


def test_a_trajectory_is_smooth_and_its_speed_is_the_derivative_of_its_place() -> None:
    path = lane_path(straight_road(600.0, 0.0), 0)
    times = np.arange(0.0, 20.0, 0.1)
    car = Trajectory(path, times, 50.0 + 8.0 * times + 5.0 * np.sin(times / 3), Sway(), 4)
    moments = np.linspace(1.0, 15.0, 200)
    step = 1e-4
    place = [car.poses(moments + d)[:, :3, 3] for d in (-step, 0.0, step)]
    speed = np.linalg.norm(place[2] - place[0], axis=1) / (2 * step)
    assert speed == pytest.approx(car.speed(moments), rel=2e-3)
    acceleration = np.linalg.norm(place[0] - 2 * place[1] + place[2], axis=1) / step**2
    assert acceleration.max() < 2.0


def test_beyond_its_times_a_vehicle_goes_on_at_its_speed() -> None:
    path = lane_path(straight_road(600.0, 100.0), 0)
    car = Trajectory(path, np.arange(5.0), 200.0 + 10.0 * np.arange(5.0), STEADY, 0)
    assert car.distance(np.array([-2.0, 7.0])) == pytest.approx([180.0, 270.0])
