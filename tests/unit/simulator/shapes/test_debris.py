from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from simulator.samples.labelled_mesh import debris_mesh
from simulator.shapes.debris import Debris, DebrisKind, debris, random_debris, random_sizes
from simulator.shapes.footprint import footprint_polygon

KINDS, SEEDS = st.sampled_from(DebrisKind), st.integers(0, 10_000)


def signed_volume_m3(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def solids(triangles: np.ndarray, vertices: int) -> np.ndarray:
    """Number of the solid that each triangle belongs to."""
    parent = np.arange(vertices)
    for _ in range(vertices):
        least = parent[triangles].min(axis=1)
        new = parent.copy()
        np.minimum.at(new, triangles.ravel(), np.repeat(least, 3))
        if (new == parent).all():
            break
        parent = new
    return parent[triangles[:, 0]]


@settings(max_examples=30, deadline=None)
@given(KINDS, SEEDS, st.floats(0.2, 3.0), st.floats(0.2, 2.0), st.floats(0.05, 1.0))
def test_a_thing_fills_its_box_and_stands_on_the_road(
    kind: DebrisKind, seed: int, length: float, width: float, height: float
) -> None:
    thing = debris(kind, seed, length, width, height)
    assert (thing.length_m, thing.width_m, thing.relief_m) == pytest.approx((length, width, height))
    low, high = thing.mesh.vertices_m.min(axis=0), thing.mesh.vertices_m.max(axis=0)
    assert low == pytest.approx([-length / 2, -width / 2, 0.0], abs=1e-9)
    assert high == pytest.approx([length / 2, width / 2, height], abs=1e-9)


@pytest.mark.parametrize("kind", DebrisKind)
def test_every_shape_is_closed_and_turned_outwards(kind: DebrisKind) -> None:
    for seed in range(4):
        mesh = debris_mesh(debris(kind, seed, *random_sizes(kind, seed)))
        edges = np.concatenate([mesh.triangles[:, pair] for pair in ((0, 1), (1, 2), (2, 0))])
        there, counts = np.unique(edges, axis=0, return_counts=True)
        back = np.unique(edges[:, ::-1], axis=0)
        # Each edge is walked as often one way as the other: the surface has no border.
        assert np.array_equal(there, back)
        assert counts.max() == 1
        solid = solids(mesh.triangles, len(mesh.vertices_m))
        for number in np.unique(solid):
            assert signed_volume_m3(mesh.vertices_m, mesh.triangles[solid == number]) > 0
        assert mesh.label.min() == 1


@settings(max_examples=15, deadline=None)
@given(SEEDS)
def test_any_thing_is_of_a_plausible_size_and_covers_its_middle(seed: int) -> None:
    thing = random_debris(seed)
    assert 0.2 <= thing.length_m <= 3.0
    assert 0.1 <= thing.relief_m <= 0.5
    assert thing.footprint_area_m2 <= thing.length_m * thing.width_m * 1.000001
    assert thing.volume_m3 <= thing.footprint_area_m2 * thing.relief_m * 1.000001
    assert math.hypot(thing.length_m, thing.width_m) / 2 >= thing.reach_m - 1e-9
    assert thing.covers(np.array([0.0, 5.0]), np.zeros(2)).tolist() == [True, False]


@pytest.mark.parametrize("kind", DebrisKind)
def test_the_footprint_polygon_of_a_thing_is_the_hull_of_its_plan(kind: DebrisKind) -> None:
    thing = debris(kind, 3, *random_sizes(kind, 3))
    polygon = footprint_polygon(thing)
    assert np.ptp(polygon, axis=0) == pytest.approx([thing.length_m, thing.width_m])
    x, y = polygon.T
    area = float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)
    assert area == pytest.approx(thing.footprint_area_m2)
    assert len(ConvexHull(polygon).vertices) == len(polygon)


@pytest.mark.parametrize("kind", DebrisKind)
def test_the_same_seed_gives_the_same_thing_and_another_seed_another(kind: DebrisKind) -> None:
    one, again, other = (debris(kind, seed, 0.6, 0.5, 0.3).mesh.vertices_m for seed in (1, 1, 2))
    assert one.tobytes() == again.tobytes()
    assert one.shape != other.shape or not np.array_equal(one, other)


def test_all_shapes_come_up_among_random_things() -> None:
    seen = {random_debris(seed).colour for seed in range(120)}
    assert len(seen) >= 6


def test_growth_keeps_the_height() -> None:
    grown: Debris = debris(DebrisKind.ROCK, 1, 0.5, 0.4, 0.3).grown(1.44)
    assert (grown.length_m, grown.width_m, grown.relief_m) == pytest.approx((0.6, 0.48, 0.3))


@pytest.mark.parametrize("sizes", [(0.01, 0.5, 0.5), (0.5, 11.0, 0.5), (0.5, 0.5, math.nan), (0.5, 0.5, -1.0)])
def test_an_impossible_size_is_refused(sizes: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="of debris must be between"):
        debris(DebrisKind.TYRE, 1, *sizes)
