from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.geometry import Kind
from simulator.scene.scenery import Surface
from simulator.scene.terrain import Terrain
from simulator.streets.street import GeoReference, Street, fill, first_light_street, grow
from simulator.world import World

METRES = st.floats(-2_000, 2_000)


@given(METRES, METRES, st.floats(-100, 100))
def test_positions_survive_the_way_to_the_earth_and_back(east: float, north: float, up: float) -> None:
    reference: GeoReference = Street(seed=0).georeference
    position, altitude = reference.geodetic_from_enu(np.array([east, north, up]))
    assert reference.enu_from_geodetic(position, altitude) == pytest.approx([east, north, up], abs=1e-4)


def test_the_street_is_turned_by_its_yaw_counter_clockwise_from_east() -> None:
    street = Street(seed=0)
    ahead = street.enu_from_street[:3, :3] @ np.array([1.0, 0.0, 0.0])
    assert np.degrees(np.arctan2(ahead[1], ahead[0])) == pytest.approx(35.0)
    assert street.enu_from_street[:3, :3] @ street.enu_from_street[:3, :3].T == pytest.approx(np.eye(3))


def test_the_first_light_street_holds_two_potholes_a_bump_and_debris_in_the_right_lane() -> None:
    for seed in range(20):
        obstacles = first_light_street(seed).obstacles
        assert [o.kind for o in obstacles] == [Kind.POTHOLE, Kind.BUMP, Kind.DEBRIS, Kind.POTHOLE]
        assert all(210 < o.x_m < 292 and -3.1 < o.y_m < -0.5 for o in obstacles)
        assert all(b.x_m - a.x_m >= 14 for a, b in itertools.pairwise(obstacles))


def test_growing_one_obstacle_leaves_the_others() -> None:
    street = first_light_street(1)
    grown = grow(street, 1, 1.25)
    before, after = street.obstacle(1).shape, grown.obstacle(1).shape
    assert after.footprint_area_m2 == pytest.approx(1.25 * before.footprint_area_m2)
    assert grown.obstacles[1:] == street.obstacles[1:]


def test_an_unknown_obstacle_cannot_be_filled() -> None:
    with pytest.raises(KeyError):
        fill(first_light_street(1), 99)


def test_a_filled_pothole_leaves_the_sound_road() -> None:
    street = first_light_street(1)
    hole = street.obstacle(1)
    x, y = np.array([hole.x_m]), np.array([hole.y_m])
    assert Terrain(street).height_at(x, y)[0] < street.sound_height(x, y)[0] - 0.05
    assert Terrain(fill(street, 1)).height_at(x, y)[0] == pytest.approx(street.sound_height(x, y)[0], abs=0.01)


def test_the_road_is_rough_by_millimetres() -> None:
    street = Street(seed=2)
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0, 50, 0.2), np.arange(-3.4, 3.4, 0.2)))
    roughness = Terrain(street).height_at(x, y) - street.sound_height(x, y)
    assert 0.002 < roughness.std() < 0.008


def test_the_roads_mesh_has_no_cracks_and_is_fine_where_it_matters() -> None:
    street = first_light_street(1)
    mesh = Terrain(street).mesh(street.main)
    hole = street.obstacle(1)
    near = np.hypot(mesh.vertices_m[:, 0] - hole.x_m, mesh.vertices_m[:, 1] - hole.y_m) < 0.3
    assert near.sum() > 0.9 * np.pi * 0.3**2 / 0.02**2


def test_no_ray_falls_through_the_road_where_fine_and_coarse_cells_meet(world: World) -> None:
    rng = np.random.default_rng(0)
    hole = world.street.obstacle(1)
    xy = np.array([hole.x_m, hole.y_m]) + rng.uniform(-1.3, 1.3, (20_000, 2))
    xy = xy[np.abs(xy[:, 1]) < 3.45]
    above = np.column_stack([xy, np.full(len(xy), 0.5)]).astype(np.float32)
    hits = world.cast(above, np.tile(np.float32([0, 0, -1]), (len(xy), 1)))
    assert (world.surfaces(hits) == Surface.ROAD).all()
    difference = np.abs(0.5 - hits.distance - world.terrain.height_at(xy[:, 0], xy[:, 1]))
    undisturbed = np.hypot(xy[:, 0] - hole.x_m, xy[:, 1] - hole.y_m) > hole.shape.reach_m
    # Straight between vertices up to 25 cm apart, the roughness between 5 cm.
    assert difference[undisturbed].max() < 0.004
    # On walls and broken rims the mesh is straight between vertices 2 cm apart, the shape between 1 cm.
    assert difference.max() < 0.02
