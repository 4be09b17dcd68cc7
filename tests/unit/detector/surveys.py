"""Surveys of a road with one hole or hump, for the tests."""

from __future__ import annotations

import numpy as np

Points = np.ndarray


def road(count: int = 20_000, side_m: float = 1.5, noise_m: float = 0.001, seed: int = 0) -> Points:
    """Points (N, 3) on a flat square about the origin."""
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-0.5 * side_m, 0.5 * side_m, (count, 2)), rng.normal(0.0, noise_m, count)])


def bowl(
    points: Points,
    length_m: float = 0.4,
    width_m: float = 0.3,
    depth_m: float = 0.06,
    at: tuple[float, float] = (0.0, 0.0),
) -> Points:
    """The same with an elliptic hole with steep walls and a flat floor; a negative depth makes a hump."""
    sunk = points.copy()
    reach = np.hypot((points[:, 0] - at[0]) / (0.5 * length_m), (points[:, 1] - at[1]) / (0.5 * width_m))
    sunk[:, 2] -= depth_m * np.clip((1.0 - reach) / 0.1, 0.0, 1.0)
    return sunk
