"""Which points of a sweep are laid on the map."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from vehicle_client.positioning.matched_points import GROUND_BELOW_M, MOST_ABOVE, MOST_GROUND, REACH_M, worth_matching

UP = np.array([0.0, 0.0, 1.0, 1.7])


def sweep(seed: int, above: int, ground: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    high = random.uniform([-90, -90, -1.2], [90, 90, 8], (above, 3))
    low = random.uniform([-90, -90, -1.8], [90, 90, -1.5], (ground, 3))
    return random.permutation(np.vstack([high, low])).astype(np.float32)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.integers(0, 60_000), st.integers(0, 6_000))
def test_of_what_is_above_and_of_the_ground_each_so_many_th_is_taken_in_their_order(
    seed: int, above: int, ground: int
) -> None:
    points = sweep(seed, above, ground)
    is_ground = points[:, 2] + np.float32(1.7) <= GROUND_BELOW_M
    expected = []
    for kind, most in ((points[~is_ground], MOST_ABOVE), (points[is_ground], MOST_GROUND)):
        expected.append(kind[:: math.ceil(max(1, len(kind)) / most)])
    both = np.vstack(expected)
    both = both[np.square(both).sum(axis=1) < REACH_M**2]
    chosen = worth_matching(points, UP)
    assert np.array_equal(chosen, both.astype(np.float64))
    assert len(chosen) <= MOST_ABOVE + MOST_GROUND


def test_what_is_not_finite_or_out_of_reach_is_left_out() -> None:
    bad = [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, -np.inf], [3e38, 3e38, 0], [0, 0, np.nan], [REACH_M, 1, 0]]
    good = [[5, 1, 0], [5, 1, -1.7]]
    assert worth_matching(np.array(bad + good, dtype=np.float32), UP).tolist() == np.float32(good).tolist()


def test_a_sweep_without_points_has_none() -> None:
    assert worth_matching(np.empty((0, 3), dtype=np.float32), UP).shape == (0, 3)
