"""The paper's saliency, equation by equation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from detector.neighbours.nearest import find_neighbourhoods
from detector.saliency.cloud_saliency import geometric_saliency, saliency_map, scale_to_unit, swift_geometric_saliency
from detector.saliency.normals import face_normals, pca_normals
from detector.saliency.rpca import decompose, default_lambda, partial_svd, soft_threshold
from detector.saliency.spectral import absolute_scale, inverse_frobenius, inverse_frobenius_and_sum


def cube(steps: int = 21) -> np.ndarray:
    """Surface of a unit cube about the origin, on a grid, each point once."""
    axis = np.linspace(-0.5, 0.5, steps)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid[np.isclose(np.abs(grid).max(axis=1), 0.5)]


def sides_touched(points: np.ndarray) -> np.ndarray:
    return np.isclose(np.abs(points), 0.5).sum(axis=1)


def neighbourhoods(points: np.ndarray, k: int) -> np.ndarray:
    return np.asarray(cKDTree(points).query(points, k=k)[1])


def unit_normals(seed: int, shape: tuple[int, ...]) -> np.ndarray:
    normals = np.random.default_rng(seed).normal(size=shape)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


@pytest.mark.parametrize("from_faces", [False, True])
def test_a_cubes_corners_are_more_salient_than_its_edges_and_these_than_its_faces(from_faces: bool) -> None:
    points = cube()
    saliency = saliency_map(points, neighbours=12, from_faces=from_faces)
    touched = sides_touched(points)
    # A face's middle: farther than the neighbourhood from every edge.
    flat = np.sort(np.abs(points), axis=1)[:, 1] < 0.25
    corner, edge, face = saliency[touched == 3].mean(), saliency[touched == 2].mean(), saliency[flat].mean()
    assert corner > edge > face


def test_the_inverse_norm_of_the_eigenvalues_is_the_inverse_frobenius_norm() -> None:
    normals = unit_normals(1, (50, 31, 3))
    scatter = np.einsum("nki,nkj->nij", normals, normals)
    eigenvalues = np.linalg.eigvalsh(scatter)
    assert inverse_frobenius(normals) == pytest.approx(1.0 / np.linalg.norm(eigenvalues, axis=1), rel=1e-12)


def test_the_absolute_scale_is_one_on_a_plane_whatever_the_signs_and_root_three_where_normals_point_everywhere() -> (
    None
):
    signs = np.where(np.arange(31) % 2 == 0, 1.0, -1.0)
    plane = np.array([0.6, 0.0, 0.8]) * signs[None, :, None]
    assert absolute_scale(plane)[0] == pytest.approx(1.0)
    everywhere = np.tile(np.eye(3), (10, 1))[None]
    assert absolute_scale(everywhere)[0] == pytest.approx(np.sqrt(3.0))


@pytest.mark.parametrize("estimate", [pca_normals, lambda p, n: face_normals(p, n[:, 1:])])
def test_the_normal_of_a_tilted_plane_is_found_and_points_up(estimate) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(2)
    xy = rng.uniform(-1, 1, (300, 2))
    points = np.column_stack([xy, 0.3 * xy[:, 0] - 0.2 * xy[:, 1] + 5.0])
    expected = np.array([-0.3, 0.2, 1.0]) / np.linalg.norm([-0.3, 0.2, 1.0])
    assert estimate(points, neighbourhoods(points, 12)) == pytest.approx(np.tile(expected, (300, 1)), abs=1e-6)


def test_pca_normals_in_closed_form_are_the_eigenvectors_of_the_smallest_eigenvalue() -> None:
    points = np.random.default_rng(3).normal(size=(200, 3))
    neighbours = neighbourhoods(points, 10)
    offsets = points[neighbours] - points[neighbours].mean(axis=1, keepdims=True)
    expected = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))[1][:, :, 0]
    assert np.abs(np.einsum("ni,ni->n", pca_normals(points, neighbours), expected)) == pytest.approx(1.0, abs=1e-6)


def test_coinciding_points_have_a_normal_and_no_saliency() -> None:
    points = np.full((40, 3), 2.5)
    assert np.isfinite(pca_normals(points, neighbourhoods(points, 9))).all()
    assert np.isfinite(face_normals(points, neighbourhoods(points, 9))).all()
    assert saliency_map(points, neighbours=8) == pytest.approx(0.0)


def test_rpca_recovers_a_planted_low_rank_and_a_planted_sparse_matrix() -> None:
    rng = np.random.default_rng(4)
    low = (rng.normal(size=(2000, 2)) @ rng.normal(size=(2, 60))).astype(np.float32)
    sparse = np.zeros_like(low)
    hit = rng.random(low.shape) < 0.02
    sparse[hit] = rng.choice([-8.0, 8.0], hit.sum())
    # The sparse part alone has a tenth of the sum of singular values: it must not let the rank grow.
    L, S = decompose(low + sparse, lam=0.1, epsilon=0.2, iterations=30)
    assert np.linalg.norm(L - low) < 0.12 * np.linalg.norm(low)
    assert (np.abs(S[hit]) > 4.0).mean() > 0.99
    assert (np.abs(S[~hit]) > 0.5).mean() < 0.01


def test_the_rank_grows_only_while_the_last_singular_value_matters() -> None:
    rng = np.random.default_rng(5)
    one = np.outer(rng.normal(size=500), rng.normal(size=30)).astype(np.float32)
    two = one + np.outer(rng.normal(size=500), rng.normal(size=30)).astype(np.float32)
    for planted, rank in ((one, 1), (two, 2)):
        L, _ = decompose(planted, lam=10.0, iterations=6)
        assert np.linalg.matrix_rank(L, tol=1e-2 * np.linalg.norm(planted)) == rank
        assert pytest.approx(planted, abs=1e-3) == L


def test_the_partial_svd_through_the_gram_matrix_is_the_best_approximation() -> None:
    X = np.random.default_rng(6).normal(size=(300, 20)).astype(np.float32)
    U, s, Vt = np.linalg.svd(X.astype(np.float64), full_matrices=False)
    L, sigma = partial_svd(X, 3)
    assert sigma == pytest.approx(s[:3], rel=1e-4)
    assert pytest.approx((U[:, :3] * s[:3]) @ Vt[:3], abs=1e-3) == L


@given(st.lists(st.floats(-10, 10, width=32), min_size=1, max_size=20), st.floats(0, 5))
def test_shrinkage_moves_every_value_by_the_threshold_towards_zero(values: list[float], lam: float) -> None:
    x = np.array(values)
    expected = np.sign(x) * np.maximum(np.abs(x) - lam, 0.0)
    assert soft_threshold(x, lam) == pytest.approx(expected, abs=1e-6)  # type: ignore[arg-type]


def test_lambda_is_the_one_that_rebuilds_the_papers_first_table() -> None:
    assert default_lambda(10_000) == pytest.approx(1.0 / np.sqrt(30_000.0))


def test_geometric_saliency_is_that_of_the_points_own_normal() -> None:
    around = np.tile(np.array([0.0, 0.0, 1.0]), (400, 11, 1))
    around[7, 0] = (1.0, 0.0, 0.0)
    around[9, 4] = (1.0, 0.0, 0.0)
    saliency = geometric_saliency(around)
    assert np.argmax(saliency) == 7
    assert saliency[9] < 0.1 * saliency[7]


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 1000), st.floats(-np.pi, np.pi), st.tuples(*[st.floats(-50, 50)] * 3))
def test_spectral_saliency_stays_with_the_points_when_they_are_turned_about_z_and_shifted(
    seed: int, angle: float, shift: tuple[float, float, float]
) -> None:
    points = np.random.default_rng(seed).normal(size=(150, 3))
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
    neighbours = neighbourhoods(points, 12)
    before = absolute_scale(pca_normals(points, neighbours)[neighbours])
    after = absolute_scale(pca_normals(points @ turn.T + shift, neighbours)[neighbours])
    assert after == pytest.approx(before, rel=1e-5)


def test_scaling_maps_to_zero_and_one_and_equal_values_to_zero() -> None:
    assert scale_to_unit(np.array([2.0, 3.0, 4.0])) == pytest.approx([0.0, 0.5, 1.0])
    assert scale_to_unit(np.full(5, 7.0)) == pytest.approx(0.0)


def street(seed: int, count: int = 9000) -> np.ndarray:
    """A rough road with a hole, a kerb and a wall: normals in several directions."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 12, count), rng.uniform(-4, 4, count)
    z = np.where(np.hypot(x - 6, y) < 0.6, -0.1, 0.0) + np.where(y > 3, 0.12, 0.0) + rng.normal(0, 0.005, count)
    along, up = rng.uniform(0, 12, count // 3), rng.uniform(0, 3, count // 3)
    wall = np.column_stack([along, 4.0 + 0.2 * np.sin(3.0 * up) + rng.normal(0, 0.005, count // 3), up])
    return np.vstack([np.column_stack([x, y, z]), wall])


def test_the_map_is_that_of_the_whole_scheme_with_sorted_neighbours() -> None:
    points = street(1)
    near = neighbourhoods(points, 31)
    around = pca_normals(points, near)[near]
    whole = 0.5 * scale_to_unit(geometric_saliency(around)) + 0.5 * scale_to_unit(inverse_frobenius(around))
    swift = saliency_map(points)
    top = len(points) // 10
    shared = np.intersect1d(np.argsort(whole)[-top:], np.argsort(swift)[-top:])
    assert np.corrcoef(whole, swift)[0, 1] > 0.999
    assert len(shared) > 0.98 * top


def test_the_swift_geometric_saliency_stays_near_the_whole_schemes() -> None:
    cloud = find_neighbourhoods(street(2), 31)
    normals = pca_normals(cloud.points, cloud.nearest)
    _, total = inverse_frobenius_and_sum(normals, cloud.nearest)
    swift = swift_geometric_saliency(normals, total, 31)
    own = np.arange(len(normals))
    nearest = np.column_stack(
        [own, np.where(cloud.nearest == own[:, None], cloud.nearest[:, :1], cloud.nearest)[:, 1:]]
    )
    assert np.corrcoef(swift, geometric_saliency(normals[nearest]))[0, 1] > 0.999


def test_one_pass_gives_what_the_definition_of_the_spectral_saliency_gives() -> None:
    normals = unit_normals(7, (400, 3)).astype(np.float32)
    nearest = np.random.default_rng(8).integers(0, 400, (400, 31)).astype(np.int32)
    inverse, total = inverse_frobenius_and_sum(normals, nearest)
    assert inverse == pytest.approx(inverse_frobenius(normals[nearest].astype(np.float64)), rel=1e-5)
    assert total == pytest.approx(normals[nearest].sum(axis=1), abs=1e-5)


def test_the_map_of_a_cloud_has_the_same_bytes_each_time() -> None:
    points = street(3)
    assert saliency_map(points).tobytes() == saliency_map(points).tobytes()


def test_a_sound_flat_road_has_no_salient_point() -> None:
    x, y = np.meshgrid(np.arange(60) * 0.1, np.arange(60) * 0.1)
    assert not saliency_map(np.column_stack([x.ravel(), y.ravel(), 0.02 * x.ravel()])).any()


def test_the_map_does_not_depend_on_unit_or_origin() -> None:
    points = street(4)
    elsewhere = saliency_map(points * 1000.0 + np.array([4e5, -2e5, 1e5]))
    assert elsewhere == pytest.approx(saliency_map(points), abs=0.02)
