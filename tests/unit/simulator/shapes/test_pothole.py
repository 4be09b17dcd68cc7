from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contract.geometry import Kind
from simulator.scene.terrain import Terrain
from simulator.shapes.debris import broken_pallet
from simulator.shapes.pothole import GRID_STEP_M, LIMITS, PotholeShape, bump, pothole
from simulator.shapes.relief import Material
from simulator.streets.road import straight_road
from simulator.streets.street import PlacedObstacle, Street
from simulator.world import World

SEEDS = st.integers(0, 10_000)


@settings(max_examples=25, deadline=None)
@given(SEEDS, st.floats(0.35, 1.5), st.floats(0.3, 1.0), st.floats(0.04, 0.2))
def test_a_pothole_has_the_size_that_was_asked_for(seed: int, length: float, width: float, depth: float) -> None:
    hole = pothole(seed, length, width, depth)
    assert hole.length_m == pytest.approx(length, abs=3 * GRID_STEP_M)
    assert hole.width_m == pytest.approx(width, abs=3 * GRID_STEP_M)
    assert hole.relief_m == pytest.approx(depth)
    assert 0.6 < hole.footprint_area_m2 / (length * width) < 1.0
    assert (hole.heights_m[hole.footprint] <= 0).all()


@settings(max_examples=25, deadline=None)
@given(SEEDS)
def test_the_border_of_a_relief_meets_the_road(seed: int) -> None:
    for relief in (pothole(seed, 0.9, 0.7, 0.12), bump(seed, 0.9, 0.6, 0.09)):
        edges = (relief.heights_m[0], relief.heights_m[-1], relief.heights_m[:, 0], relief.heights_m[:, -1])
        assert max(np.abs(edge).max() for edge in edges) < 0.001


def test_the_rim_of_a_pothole_stands_up_a_little_and_no_more() -> None:
    hole = pothole(4, 0.9, 0.7, 0.12)
    rim = hole.heights_m[~hole.footprint]
    assert 0.003 < rim.max() < 0.02
    assert rim.min() > -0.02


def test_a_bump_only_rises() -> None:
    rise = bump(1, 0.9, 0.6, 0.09)
    assert rise.heights_m.min() == 0
    assert rise.relief_m == pytest.approx(0.09)


@settings(max_examples=25, deadline=None)
@given(SEEDS, st.floats(0.5, 2.0))
def test_growth_multiplies_the_area_and_keeps_the_depth(seed: int, factor: float) -> None:
    for shape in (pothole(seed, 0.9, 0.7, 0.12), bump(seed, 0.6, 0.5, 0.08), broken_pallet(seed, 0.8, 0.6, 0.3)):
        grown = shape.grown(factor)
        assert grown.footprint_area_m2 == pytest.approx(factor * shape.footprint_area_m2)
        assert grown.length_m * grown.width_m == pytest.approx(factor * shape.length_m * shape.width_m)
        assert grown.relief_m == pytest.approx(shape.relief_m)


def test_the_same_seed_gives_the_same_hole_and_another_seed_another() -> None:
    one, again, other = pothole(5, 0.9, 0.7, 0.12), pothole(5, 0.9, 0.7, 0.12), pothole(6, 0.9, 0.7, 0.12)
    assert one.heights_m.tobytes() == again.heights_m.tobytes()
    assert one.heights_m.tobytes() != other.heights_m.tobytes()


def test_heights_between_grid_points_lie_between_their_neighbours() -> None:
    hole = pothole(7, 0.9, 0.7, 0.12)
    rows, columns = hole.heights_m.shape
    x = (np.arange(columns - 1) + 0.5 - (columns - 1) / 2) * hole.step_m
    middle = hole.height_at(x, np.zeros_like(x))
    row = hole.heights_m[(rows - 1) // 2]
    assert (middle <= np.maximum(row[:-1], row[1:]) + 1e-12).all()
    assert (middle >= np.minimum(row[:-1], row[1:]) - 1e-12).all()


def test_a_pallet_stands_on_the_road_and_fills_its_box() -> None:
    pallet = broken_pallet(2, 0.8, 0.6, 0.3)
    assert pallet.mesh.vertices_m[:, 2].min() == pytest.approx(0)
    assert (pallet.length_m, pallet.width_m, pallet.relief_m) == pytest.approx((0.8, 0.6, 0.3))
    inside = pallet.covers(np.array([0.0, 0.6]), np.array([0.0, 0.0]))
    assert inside.tolist() == [True, False]


SHAPES = st.builds(
    PotholeShape,
    length_m=st.floats(0.3, 2.0),
    width_m=st.floats(0.3, 1.5),
    depth_m=st.floats(0.03, 0.2),
    wall_m=st.floats(0.02, 0.3),
    outline_roughness=st.floats(0.0, 0.15),
    rim_roughness_m=st.floats(0.0, 0.02),
    rim_crest_m=st.floats(0.0, 0.03),
    lobes=st.integers(1, 5),
    water=st.sampled_from([0.0, 0.3, 1.0]),
)


@settings(max_examples=40, deadline=None)
@given(SHAPES, SEEDS)
def test_a_hole_of_any_shape_fills_its_box_however_ragged_its_edge(shape: PotholeShape, seed: int) -> None:
    hole = shape.relief(seed)
    assert hole.length_m == pytest.approx(shape.length_m, abs=2.01 * GRID_STEP_M)
    assert hole.width_m == pytest.approx(shape.width_m, abs=2.01 * GRID_STEP_M)
    assert hole.relief_m == pytest.approx(shape.depth_m)
    rows, columns = np.nonzero(hole.footprint)
    middle = (np.array(hole.footprint.shape) - 1) / 2
    centre = np.array([rows.min() + rows.max(), columns.min() + columns.max()]) / 2
    assert np.abs(centre - middle).max() <= 1.0


@settings(max_examples=40, deadline=None)
@given(SHAPES, SEEDS)
def test_inside_the_footprint_a_hole_only_falls_and_outside_it_only_rises(shape: PotholeShape, seed: int) -> None:
    hole = shape.relief(seed)
    assert hole.is_hole
    assert (hole.solid_m[hole.footprint] <= 0).all()
    assert (hole.solid_m[~hole.footprint] >= 0).all()
    assert hole.solid_m.max() <= 2.4 * shape.rim_crest_m
    assert 0 < hole.volume_m3 <= hole.relief_m * hole.footprint_area_m2


def test_a_wider_wall_is_less_steep_and_holds_less() -> None:
    steep, flat = (PotholeShape(1.0, 1.0, 0.1, wall_m=wall, floor_texture=()).relief(3) for wall in (0.04, 0.30))
    gradients = [np.hypot(*np.gradient(hole.heights_m, hole.step_m)) for hole in (steep, flat)]
    steepest = [
        float(np.quantile(gradient[hole.footprint], 0.95))
        for gradient, hole in zip(gradients, (steep, flat), strict=True)
    ]
    assert steepest[0] > 2 * steepest[1]
    assert steep.volume_m3 > 1.2 * flat.volume_m3


def test_a_wall_falls_over_the_width_that_was_asked_for() -> None:
    hole = PotholeShape(1.4, 1.4, 0.10, wall_m=0.20, outline_roughness=0.0, rim_crest_m=0.0, floor_texture=()).relief(1)
    rows, columns = hole.heights_m.shape
    profile = hole.heights_m[rows // 2, : columns // 2]
    inside = np.flatnonzero(profile < 0)[0]
    bottom = np.flatnonzero(profile < -0.097)[0]
    # The wall's slope varies by a third, and its last per cents belong to a rounded foot.
    assert 0.5 * 0.20 < (bottom - inside) * hole.step_m < 1.5 * 0.20


def test_several_lobes_leave_a_waist_that_one_has_not() -> None:
    shares = {
        lobes: np.mean([PotholeShape(1.2, 0.8, 0.1, lobes=lobes).relief(seed).footprint_area_m2 for seed in range(12)])
        for lobes in (1, 3)
    }
    assert shares[3] < 0.92 * shares[1]


def test_a_repair_is_flat_and_of_fresh_asphalt() -> None:
    for seed in range(10):
        repair = PotholeShape(1.0, 0.8, 0.1, repaired=True).relief(seed)
        assert repair.relief_m < 0.011
        assert repair.materials is not None
        assert (repair.materials[repair.footprint] == Material.PATCH).all()
        assert repair.length_m == pytest.approx(1.0, abs=2.01 * GRID_STEP_M)


def test_random_holes_are_plausible_and_all_can_be_made() -> None:
    holes = [PotholeShape.random(seed) for seed in range(300)]
    assert all(0.2 <= hole.length_m <= 1.6 and hole.width_m <= hole.length_m for hole in holes)
    assert all(0.025 <= hole.depth_m <= 0.15 for hole in holes)
    assert 0.1 < np.mean([hole.water > 0 for hole in holes]) < 0.3
    assert {hole.lobes for hole in holes} == {1, 2, 3}
    assert PotholeShape.random(5) == PotholeShape.random(5) != PotholeShape.random(6)


@pytest.mark.parametrize("name", LIMITS)
def test_a_size_beyond_its_limits_is_a_clear_error(name: str) -> None:
    usual = {"length_m": 0.8, "width_m": 0.6, "depth_m": 0.08}
    low, high = LIMITS[name]
    for value in (low - 0.001, high * 1.001 + 0.001, float("nan")):
        with pytest.raises(ValueError, match=f"{name} of a pothole must be between {low} and {high}"):
            PotholeShape(**(usual | {name: value}))


@pytest.mark.parametrize("texture", [((0.15, 0.3), (0.02, 0.2)), ((0.001, 0.1),), ((0.1, -0.1),)])
def test_a_floor_that_would_reach_the_road_is_a_clear_error(texture: tuple[tuple[float, float], ...]) -> None:
    with pytest.raises(ValueError, match="floor_texture"):
        PotholeShape(0.8, 0.6, 0.08, floor_texture=texture)


@pytest.mark.parametrize("lobes", [0, 6])
def test_a_number_of_lobes_that_cannot_be_is_a_clear_error(lobes: int) -> None:
    with pytest.raises(ValueError, match="lobes of a pothole"):
        PotholeShape(0.8, 0.6, 0.08, lobes=lobes)


def test_rays_into_a_road_meet_the_sizes_that_the_truth_states_also_of_aged_and_flooded_holes() -> None:
    dry = PotholeShape(0.9, 0.7, 0.1).relief(3)
    wet = PotholeShape(0.9, 0.7, 0.1, water=0.6).relief(3)
    shapes = (dry, dry.aged(44.0), wet.aged(44.0), dry.filled(0.5, 1))
    placed = tuple(
        PlacedObstacle(number, Kind.POTHOLE, 10.0 * number, -1.75, 0.3 * number, shape)
        for number, shape in enumerate(shapes, start=1)
    )
    street = Street(1, placed, roads=(straight_road(50.0, 20.0),))
    sound = Terrain(replace(street, obstacles=()))
    world = World(street)
    axis = np.arange(-1.0, 1.0, 0.005)
    for obstacle, shape in zip(placed, shapes, strict=True):
        x, y = (at.ravel() for at in np.meshgrid(axis + obstacle.x_m, axis + obstacle.y_m))
        hits = world.cast(
            np.stack([x, y, np.ones_like(x)], axis=1).astype(np.float32), np.tile(np.float32([0, 0, -1]), (len(x), 1))
        )
        points = np.stack([x, y, 1.0 - hits.distance], axis=1)
        on = world.obstacle_ids(hits, points) == obstacle.obstacle_id
        assert [np.ptp(side) for side in obstacle.local(x[on], y[on])] == pytest.approx(
            [shape.length_m, shape.width_m], abs=1.5 * shape.step_m
        )
        assert np.count_nonzero(on) * 0.005**2 == pytest.approx(shape.footprint_area_m2, rel=0.01)
        depth = sound.height_at(x[on], y[on]) - points[on, 2]
        met_m3 = -shape.heights_m[shape.footprint].sum() * shape.step_m**2
        assert depth.sum() * 0.005**2 == pytest.approx(met_m3, rel=0.03)
        assert depth.max() == pytest.approx(-shape.heights_m[shape.footprint].min(), abs=0.012)
        assert shape.relief_m >= depth.max() - 0.012
