from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from simulator.lidar import LidarModel, azimuths
from simulator.mesh import pose
from simulator.motion import Standing
from simulator.scenery import Surface
from simulator.street import Street, fill, first_light_street
from simulator.world import World

HOLE_X_M = first_light_street(seed=3).obstacle(1).x_m
STREET_FROM_SENSOR = pose(HOLE_X_M - 6.0, -1.75, 2.36, yaw_rad=0.05, roll_rad=0.02)
EXACT = LidarModel(range_sd_m=0.0)


def in_street(points_m: np.ndarray) -> np.ndarray:
    return points_m.astype(np.float64) @ STREET_FROM_SENSOR[:3, :3].T + STREET_FROM_SENSOR[:3, 3]


def test_a_turn_has_the_papers_number_of_rays() -> None:
    assert len(azimuths(LidarModel(), 0.0)) * 64 == pytest.approx(800_000 / 30, rel=0.005)


def test_rings_lie_at_their_elevations_from_below_to_above(world: World) -> None:
    sweep = world.sweep(EXACT, Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(0))
    points = sweep.points_m.astype(np.float64)
    elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
    assert elevation == pytest.approx(EXACT.elevations_rad[sweep.ring], abs=1e-5)
    assert np.degrees(EXACT.elevations_rad[[0, -1]]) == pytest.approx([-30, 10])
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    assert np.cos(azimuth - sweep.azimuth_rad) == pytest.approx(np.ones(len(points)), abs=1e-6)


def test_only_returns_within_range_are_given(world: World) -> None:
    sweep = world.sweep(EXACT, Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(0))
    assert len(sweep.points_m) < 64 * EXACT.columns
    assert np.linalg.norm(sweep.points_m, axis=1).max() <= EXACT.range_m + 0.01
    assert np.isfinite(sweep.points_m).all()
    assert Surface.NOTHING not in sweep.surface


def test_the_pothole_is_labelled_where_it_is_and_lies_below_the_road(world: World) -> None:
    sweep = world.sweep(EXACT, Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(1))
    points = in_street(sweep.points_m)
    hole = world.street.obstacle(1)
    labelled = sweep.obstacle_id == 1
    assert labelled.sum() > 20
    assert hole.covers(points[labelled, 0], points[labelled, 1]).mean() > 0.97
    height = points[:, 2] - world.street.sound_height(points[:, 0].astype(float), points[:, 1].astype(float))
    assert (height[labelled] < 0.015).all()
    assert height[labelled].min() < -0.5 * hole.shape.relief_m
    road = (sweep.surface == Surface.ROAD) & (sweep.obstacle_id == 0)
    assert np.abs(height[road]).max() < 0.03


def test_bump_and_debris_are_labelled_above_the_road(world: World) -> None:
    for number, x in ((2, 236.0), (3, 259.0)):
        at = pose(x, -1.75, 2.36)
        sweep = world.sweep(EXACT, Standing(at), 0.0, np.random.default_rng(1))
        points = sweep.points_m[sweep.obstacle_id == number] + at[:3, 3]
        height = points[:, 2] - world.street.sound_height(points[:, 0].astype(float), points[:, 1].astype(float))
        assert len(points) > 10
        assert height.max() > 0.6 * world.street.obstacle(number).shape.relief_m
        assert height.min() > -0.01


def test_points_on_the_road_see_its_crown(world: World) -> None:
    sweep = world.sweep(EXACT, Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(1))
    points = in_street(sweep.points_m)[(sweep.surface == Surface.ROAD) & (sweep.obstacle_id == 0)]
    slope = np.polyfit(np.abs(points[:, 1]), points[:, 2], 1)[0]
    assert slope == pytest.approx(-world.street.main.section.crown_slope, abs=0.002)


def test_the_range_noise_is_as_wide_as_stated(world: World) -> None:
    exact = world.sweep(EXACT, Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(5))
    noisy = world.sweep(LidarModel(), Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(5))
    error = np.linalg.norm(noisy.points_m, axis=1) - np.linalg.norm(exact.points_m, axis=1)
    assert error.std() == pytest.approx(0.01, rel=0.03)
    assert abs(error.mean()) < 3 * 0.01 / np.sqrt(len(error))


def test_the_same_seed_gives_the_same_bytes_and_each_turn_another_phase(world: World) -> None:
    one = world.sweep(LidarModel(), Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(7))
    again = World(first_light_street(seed=3)).sweep(
        LidarModel(), Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(7)
    )
    other = world.sweep(LidarModel(), Standing(STREET_FROM_SENSOR), 0.0, np.random.default_rng(8))
    for field in dataclasses.fields(one):
        assert getattr(one, field.name).tobytes() == getattr(again, field.name).tobytes()
    assert one.azimuth_rad[0] != other.azimuth_rad[0]


def test_a_filled_pothole_has_no_label_and_no_depth(world: World) -> None:
    street = fill(fill(world.street, 1), 3)
    repaired = World(street)
    for at, number in ((STREET_FROM_SENSOR, 1), (pose(257.0, -1.75, 2.36), 3)):
        sweep = repaired.sweep(EXACT, Standing(at), 0.0, np.random.default_rng(1))
        assert number not in sweep.obstacle_id
        points = sweep.points_m @ at[:3, :3].T + at[:3, 3]
        there = street.obstacle(number).covers(*points[:, :2].T) & (points[:, 2] < 1.0)
        assert there.sum() > 10
        assert (
            np.abs(
                points[there, 2] - street.sound_height(points[there, 0].astype(float), points[there, 1].astype(float))
            ).max()
            < 0.02
        )


def test_a_street_without_obstacles_can_be_scanned() -> None:
    sweep = World(Street(seed=1)).sweep(LidarModel(), Standing(pose(10.0, 0.0, 2.4)), 0.0, np.random.default_rng(0))
    assert not sweep.obstacle_id.any()
    assert len(sweep.points_m) > 10_000
