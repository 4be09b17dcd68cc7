from __future__ import annotations

import numpy as np
import pytest

from simulator.mesh import box, pose
from simulator.motion import Standing, rigid
from simulator.rays import RayScene
from simulator.scene import car
from simulator.scene.mover import Model, Mover
from simulator.scene.people import pedestrian
from simulator.scene.scenery import Part, Surface
from simulator.sensors.camera import CameraModel, forward_camera
from simulator.sensors.lidar import LidarModel
from simulator.streets.street import Roadside, Street
from simulator.world import World

BARE = Street(seed=1, roadsides=(Roadside.TREES, Roadside.TREES))
CRATE = Model((Part(Surface.DEBRIS, box(1.0, 1.0, 1.0)),), middle_m=0.5, radius_m=0.9)


class Sliding:
    """Straight along x at constant speed, turning about z."""

    def __init__(self, start: tuple[float, float, float], speed_mps: float, turn_radps: float = 0.0) -> None:
        self.start, self.speed_mps, self.turn_radps = np.array(start), speed_mps, turn_radps

    def poses(self, time_s: np.ndarray) -> np.ndarray:
        place = self.start + np.outer(time_s, [self.speed_mps, 0.0, 0.0])
        still = np.zeros_like(time_s)
        return rigid(place, self.turn_radps * time_s, still, still)


def rays_over(world_point: np.ndarray, count: int = 4_000) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    targets = world_point + rng.uniform(-3, 3, (count, 3)) * np.array([1.0, 1.0, 0.4])
    origin = np.array([0.0, -1.75, 1.8])
    directions = targets - origin
    return origin.astype(np.float32), (directions / np.linalg.norm(directions, axis=1)[:, None]).astype(np.float32)


def test_a_mover_is_hit_where_its_mesh_is_at_that_time() -> None:
    motion = Sliding((12.0, -1.0, 0.0), 14.0, 0.3)
    world = World(BARE, (Mover(7, CRATE, motion),))
    for time_s in (0.0, 0.35):
        place = motion.poses(np.array([time_s]))[0]
        origin, directions = rays_over(place[:3, 3] + [0, 0, 0.5])
        hits = world.cast(origin, directions, time_s)
        alone = RayScene([CRATE.parts[0].mesh.moved(place)]).cast(origin, directions)
        on_it = hits.mover == 7
        assert on_it.sum() > 100
        assert hits.distance[on_it] == pytest.approx(alone.distance[on_it], abs=1e-3)
        assert hits.normal[on_it] == pytest.approx(alone.normal[on_it], abs=1e-3)
        assert (world.surfaces(hits)[on_it] == Surface.DEBRIS).all()
        # What the crate does not hide, it does not touch.
        without = World(BARE).cast(origin, directions)
        assert (hits.distance[~on_it] == without.distance[~on_it]).all()
        assert (alone.distance[~on_it] >= without.distance[~on_it]).all()


def test_each_ray_meets_a_mover_at_its_own_time() -> None:
    motion = Sliding((10.0, -1.75, 0.0), 20.0)
    world = World(BARE, (Mover(1, CRATE, motion),))
    times = np.linspace(0.0, 0.5, 200)
    ahead = np.tile(np.float32([1, 0, 0]), (200, 1))
    hits = world.cast(np.float32([0.0, -1.75, 0.5]), ahead, times)
    assert (hits.mover == 1).all()
    assert hits.distance == pytest.approx(9.5 + 20.0 * times, abs=1e-3)
    shuffled = np.random.default_rng(1).permutation(200)
    assert world.cast(np.float32([0.0, -1.75, 0.5]), ahead, times[shuffled]).distance == pytest.approx(
        hits.distance[shuffled]
    )


def test_a_turn_of_the_lidar_stretches_what_moves_and_its_times_undo_it() -> None:
    motion = Sliding((9.0, 1.75, -0.04), -14.0)
    model = Model((Part(Surface.CAR, car.body()),), middle_m=0.7, radius_m=2.4)
    world = World(BARE, (Mover(3, model, motion),))
    lidar = LidarModel(rate_hz=10.0, rolling=True, range_sd_m=0.0)
    sweep = world.sweep(lidar, Standing(pose(0.0, -1.75, 2.0)), 0.1, np.random.default_rng(0))
    on_car = sweep.mover_id == 3
    assert on_car.sum() > 300
    points = sweep.points_m[on_car].astype(float) + np.array([0.0, -1.75, 2.0])
    moved = motion.poses(0.1 + sweep.time_offset_s[on_car].astype(float))
    own = np.einsum("nji,nj->ni", moved[:, :3, :3], points - moved[:, :3, 3])
    assert np.abs(own[:, 0]).max() < 2.16
    assert np.abs(own[:, 1]).max() < 0.91
    assert own[:, 2].min() > -0.01
    assert own[:, 2].max() < 1.52


def test_the_vehicle_that_looks_is_not_seen() -> None:
    world = World(BARE, (Mover(1, CRATE, Standing(pose(3.0, -1.75, 0.0))),))
    ahead, origin = np.float32([[1, 0, 0]]), np.float32([0.0, -1.75, 0.5])
    assert world.cast(origin, ahead, 0.0).mover[0] == 1
    assert world.cast(origin, ahead, 0.0, ignored_mover=1).mover[0] == 0


def test_movers_throw_shadows_where_they_are() -> None:
    motion = Sliding((0.0, 0.0, 0.0), 5.0)
    world = World(BARE, (Mover(1, CRATE, motion),))
    up = np.float32([0, 0, 1])
    below = np.float32([[0.0, 0.0, -0.2], [5.0, 0.0, -0.2], [5.0, 2.0, -0.2]])
    lid = box(1.0, 1.0, 1.0)
    assert lid.vertices_m[:, 2].min() == 0.0
    assert list(~world.reaches(below + np.float32([0, 0, 0.3]), up, 0.0)) == [True, False, False]
    assert list(~world.reaches(below + np.float32([0, 0, 0.3]), up, 1.0)) == [False, True, False]


def test_a_picture_shows_the_mover_at_its_time() -> None:
    world = World(BARE, (Mover(1, CRATE, Sliding((8.0, -1.75, 0.0), 40.0)),))
    eye = CameraModel(64, 48, vehicle_from_camera=forward_camera(0.0, 1.2, 0.1))
    near, far = (world.segment(eye, pose(0.0, -1.75, 0.0), time_s) == Surface.DEBRIS for time_s in (0.0, 1.0))
    assert near.sum() > 4 * far.sum() > 0


def test_people_are_as_tall_as_people_and_stand_on_the_ground() -> None:
    for seed in range(10):
        person = pedestrian(seed)
        z = np.concatenate([part.mesh.vertices_m[:, 2] for part in person.parts])
        assert 1.5 < z.max() < 2.0
        assert -0.02 < z.min() < 0.12
        furthest = max(np.linalg.norm(p.mesh.vertices_m - [0, 0, person.middle_m], axis=1).max() for p in person.parts)
        assert furthest <= person.radius_m
