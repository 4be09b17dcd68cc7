from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.samples.labelled_mesh import LabelledMesh
from simulator.samples.patch_mesh import SLAB_BELOW_M, patch_half_size, patch_mesh
from simulator.samples.patch_texture import patch_texture
from simulator.shapes.hump import bump
from simulator.shapes.pothole import PotholeShape
from simulator.shapes.relief import Material, Relief

HOLE = PotholeShape(0.8, 0.6, 0.08, lobes=2, water=0.4).relief(2)


def signed_volume_m3(mesh: LabelledMesh) -> float:
    a, b, c = mesh.vertices_m[mesh.triangles].transpose(1, 0, 2)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def assert_closed(mesh: LabelledMesh) -> None:
    """Every edge belongs to exactly two triangles, which walk it in opposite ways."""
    edges = np.concatenate([mesh.triangles[:, pair] for pair in ((0, 1), (1, 2), (2, 0))])
    assert len(np.unique(edges, axis=0)) == len(edges)
    assert len(np.unique(np.sort(edges, axis=1), axis=0)) * 2 == len(edges)


@settings(max_examples=15, deadline=None)
@given(
    st.integers(0, 1000),
    st.floats(0.2, 1.2),
    st.floats(0.2, 1.0),
    st.floats(0.02, 0.2),
    st.one_of(st.none(), st.floats(2.2, 12.0)),
    st.integers(800, 20_000),
)
def test_a_patch_of_any_hole_is_closed_and_turned_outwards(
    seed: int, length: float, width: float, depth: float, side: float | None, most: int
) -> None:
    relief = PotholeShape(length, width, depth).relief(seed)
    mesh = patch_mesh(relief, side, most)
    assert_closed(mesh)
    assert len(mesh.vertices_m) <= most
    half_x, half_y = patch_half_size(relief, side)
    below = float(mesh.vertices_m[:, 2].min())
    slab = 4 * half_x * half_y * -below
    # The solid is the slab less the hole, its rim aside.
    assert slab - 2 * relief.volume_m3 < signed_volume_m3(mesh) < slab + 0.01 * half_x * half_y


def test_the_border_of_a_patch_meets_the_road_exactly() -> None:
    mesh = patch_mesh(HOLE, 3.0)
    x, y, z = mesh.vertices_m.T
    on_border = (np.abs(x) == 1.5) | (np.abs(y) == 1.5)
    assert np.isin(z[on_border], [0.0, z.min()]).all()
    assert np.count_nonzero(on_border & (z == 0)) == np.count_nonzero(on_border & (z == z.min()))
    assert (np.abs(x).max(), np.abs(y).max()) == (1.5, 1.5)


def test_the_volume_missing_from_a_patch_is_that_of_the_hole() -> None:
    dry = PotholeShape(0.8, 0.6, 0.08, rim_crest_m=0.0).relief(2)
    mesh = patch_mesh(dry)
    half_x, half_y = patch_half_size(dry)
    missing = 4 * half_x * half_y * -float(mesh.vertices_m[:, 2].min()) - signed_volume_m3(mesh)
    assert missing == pytest.approx(dry.volume_m3, rel=0.02)
    assert -mesh.vertices_m[:, 2].min() - SLAB_BELOW_M == pytest.approx(dry.relief_m, rel=0.05)


@pytest.mark.parametrize("relief", [HOLE, bump(1, 0.8, 0.5, 0.07)])
def test_vertices_are_labelled_where_the_footprint_is(relief: Relief) -> None:
    mesh = patch_mesh(relief, 4.0)
    x, y, z = mesh.vertices_m.T
    top = z > z.min()
    assert (mesh.label[top] == relief.covers(x[top], y[top])).all()
    assert not mesh.label[~top].any()
    assert (mesh.material[top] == relief.material_at(x[top], y[top])).all()
    assert z[top] == pytest.approx(relief.height_at(x[top], y[top]), abs=1e-3)


def test_a_patch_is_as_fine_as_the_relief_and_coarse_at_its_border() -> None:
    mesh = patch_mesh(HOLE, 6.0)
    xs = np.unique(mesh.vertices_m[:, 0])
    assert np.diff(xs).min() == pytest.approx(HOLE.step_m, rel=0.1)
    assert np.diff(xs).max() > 10 * HOLE.step_m


@pytest.mark.parametrize("side", [0.5, 41.0, float("nan"), -2.0])
def test_a_patch_that_cannot_hold_its_hole_is_refused(side: float) -> None:
    with pytest.raises(ValueError, match="has sides of"):
        patch_half_size(HOLE, side)


def test_too_few_vertices_are_refused() -> None:
    with pytest.raises(ValueError, match="takes more than 10 vertices"):
        patch_mesh(HOLE, max_vertices=10)


def test_the_texture_shows_the_water_where_the_texture_coordinates_say() -> None:
    half = patch_half_size(HOLE, 3.0)
    texture = patch_texture(HOLE, half, seed=1)
    assert texture.shape == (1024, 1024, 3)
    mesh = patch_mesh(HOLE, 3.0)
    assert mesh.uv is not None
    assert (mesh.uv.min(), mesh.uv.max()) == (0, 1)
    rows = np.clip((1 - mesh.uv[:, 1]) * 1024, 0, 1023).astype(int)
    columns = np.clip(mesh.uv[:, 0] * 1024, 0, 1023).astype(int)
    seen = texture[rows, columns].astype(float).mean(axis=1)
    water, asphalt = mesh.material == Material.WATER, mesh.material == Material.ASPHALT
    # Muddy water is browner and darker than asphalt, and without grain.
    assert seen[water].mean() < 0.75 * seen[asphalt].mean()
    assert seen[water].std() < 0.5 * seen[asphalt].std()


def test_the_same_seed_gives_the_same_texture() -> None:
    half = patch_half_size(HOLE)
    one, again, other = (patch_texture(HOLE, half, seed).tobytes() for seed in (1, 1, 2))
    assert one == again
    assert one != other
