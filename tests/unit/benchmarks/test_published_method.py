"""The port that the detector is timed against does what the paper's method does."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.published_method import (
    alternating_minimisation,
    augmented_lagrange_multipliers,
    published_saliency,
)
from detector.saliency.cloud_saliency import saliency_map
from detector.saliency.rpca import decompose, default_lambda


def street(seed: int) -> np.ndarray:
    """A rough road with a hole, and a wall."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 8, 2500), rng.uniform(-3, 3, 2500)
    z = np.where(np.hypot(x - 4, y) < 0.6, -0.1, 0.0) + rng.normal(0, 0.005, 2500)
    up = rng.uniform(0, 3, 800)
    wall = np.column_stack([rng.uniform(0, 8, 800), 3.0 + 0.2 * np.sin(3 * up) + rng.normal(0, 0.005, 800), up])
    return np.vstack([np.column_stack([x, y, z]), wall])


def test_the_ports_map_and_ours_agree() -> None:
    points = street(1)
    theirs, ours = published_saliency(points, alternating_minimisation), saliency_map(points)
    top = len(points) // 10
    shared = np.intersect1d(np.argsort(theirs)[-top:], np.argsort(ours)[-top:])
    assert np.corrcoef(theirs, ours)[0, 1] > 0.99
    assert len(shared) > 0.95 * top


def test_alternating_minimisation_with_full_decompositions_is_ours_through_the_gram_matrix() -> None:
    E = np.random.default_rng(2).normal(size=(500, 30))
    expected = decompose(E.astype(np.float32), default_lambda(len(E)))[1]
    assert alternating_minimisation(E) == pytest.approx(expected, abs=1e-3)


def test_augmented_lagrange_multipliers_recover_a_planted_sparse_part() -> None:
    rng = np.random.default_rng(3)
    low = rng.normal(size=(400, 2)) @ rng.normal(size=(2, 40))
    sparse = np.where(rng.random(low.shape) < 0.03, rng.choice([-6.0, 6.0], low.shape), 0.0)
    assert augmented_lagrange_multipliers(low + sparse, tolerance=1e-5) == pytest.approx(sparse, abs=1e-2)
