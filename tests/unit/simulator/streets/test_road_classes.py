from __future__ import annotations

import numpy as np
import pytest

from contract.geometry import Kind
from simulator.mesh import pose
from simulator.motion import Standing
from simulator.scene.scenery import Surface
from simulator.sensors.camera import CameraModel, forward_camera
from simulator.sensors.lidar_presets import hdl64e
from simulator.shapes.pothole import PotholeShape
from simulator.streets.road_features import manhole
from simulator.streets.street import Feature, PlacedFeature, PlacedObstacle, Street
from simulator.world import World

PUDDLE = PlacedObstacle(1, Kind.POTHOLE, 12.0, -1.75, 0.4, PotholeShape(1.2, 0.9, 0.1, water=0.8).relief(3))
COVER = PlacedFeature(Feature.MANHOLE, 8.0, -1.6, 0.0, manhole(np.random.default_rng(0)))


@pytest.fixture(scope="module")
def world() -> World:
    return World(Street(seed=1, obstacles=(PUDDLE,), features=(COVER,)))


def seen_from_above(world: World, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
    above = np.column_stack([x_m, y_m, np.full(len(x_m), 2.0)]).astype(np.float32)
    hits = world.cast(above, np.tile(np.float32([0, 0, -1]), (len(x_m), 1)))
    return world.classes(hits, above - np.outer(hits.distance, [0, 0, 1]).astype(np.float32))


def test_lines_covers_and_water_are_told_from_asphalt(world: World) -> None:
    # On the middle line a dash and a gap, the edge line, a cover, a puddle's middle, plain asphalt.
    x = np.array([7.5, 11.25, 20.0, 8.0, 12.0, 20.0])
    y = np.array([0.0, 0.0, -3.2, -1.6, -1.75, -1.75])
    expected = [Surface.ROAD_MARK, Surface.ROAD, Surface.ROAD_MARK, Surface.MANHOLE, Surface.WATER, Surface.ROAD]
    assert list(seen_from_above(world, x, y)) == expected


def test_lines_are_as_wide_as_they_are_painted(world: World) -> None:
    across = np.linspace(-0.5, 0.5, 2_001)
    painted = seen_from_above(world, np.full(2_001, 15.0), across) == Surface.ROAD_MARK
    assert np.ptp(across[painted]) == pytest.approx(0.12, abs=0.002)


def test_paint_shines_water_swallows_and_both_are_labelled_in_a_turn(world: World) -> None:
    sweep = world.sweep(hdl64e(), Standing(pose(4.0, -1.75, 1.73)), 0.1, np.random.default_rng(0))
    near = np.hypot(*sweep.points_m[:, :2].T) < 12.0
    paint, asphalt = (sweep.intensity[near & (sweep.surface == s)] for s in (Surface.ROAD_MARK, Surface.ROAD))
    assert len(paint) > 100
    assert np.median(paint) > 2 * np.median(asphalt)
    assert (sweep.surface == Surface.MANHOLE).sum() > 10
    returned = ((sweep.surface == Surface.WATER) & near).sum()
    dry = World(Street(seed=1, obstacles=(), features=(COVER,)))
    there = dry.sweep(hdl64e(), Standing(pose(4.0, -1.75, 1.73)), 0.1, np.random.default_rng(0)).points_m
    on_puddle = PUDDLE.covers(there[:, 0].astype(float) + 4.0, there[:, 1].astype(float) - 1.75).sum()
    assert returned < 0.3 * on_puddle


def test_a_semantic_picture_shows_the_lines(world: World) -> None:
    eye = CameraModel(160, 90, vehicle_from_camera=forward_camera(0.6, 1.6, 0.05))
    seen = world.segment(eye, pose(0.0, -1.75, 0.0))
    assert 0.004 < (seen == Surface.ROAD_MARK).mean() < 0.05
    assert (seen == Surface.MANHOLE).any()
