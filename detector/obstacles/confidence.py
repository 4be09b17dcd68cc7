"""How likely a cluster is an obstacle: a logistic model of what lies in and around it."""

from __future__ import annotations

import numpy as np

from detector.arrays import FloatArray
from detector.obstacles.surroundings import Surroundings

# Less is not reported: between 0.6 and this lie two thirds of the false holes of one sweep and 2 % of the true ones.
MIN_CONFIDENCE = 0.8

# Intercept and weights of `features`, fitted to simulated drives by `python -m evaluation.fit_confidence`: of the
# clusters of one sweep, and of those in the grid of several.
# fmt: off
HOLE_WEIGHTS = np.array([
    -1.735, 1.271, -0.7034, 4.632, 6.042, -4.637, -9.665, -0.1985, -2.115, 3.722,
    1.891, 0.2699, -0.3445, -0.3944, -0.1112, -0.3349, -1.867, 0.5054, 2.524, -0.2134,
    -1.037,
])
RISE_WEIGHTS = np.array([
    -9.583, 0.8729, 0.409, 0.04937, 2.616, -5.053, -2.667, 0.2679, -3.307, 2.137,
    2.442, 8.891, -0.499, -0.06268, 0.009207, -1.759, -1.437, 0.6835, -0.5829, -0.1661,
    0.1972,
])
GRID_HOLE_WEIGHTS = np.array([
    -9.131, 1.917, 1.651, -3.096, 0.2085, -5.594, -8.123, 1.354, -2.65, 1.69,
    -5.592, 10.12, -2.659, -0.3404, -0.02501, -2.866, -2.69, -1.161, -2.646, 0.6514,
    -0.5421,
])
GRID_RISE_WEIGHTS = np.array([
    -23.21, 2.224, 1.896, -1.829, 1.067, -7.133, 1.005, -3.645, -2.96, 0.9009,
    0.1262, 5.262, -0.7173, -0.09579, -0.1499, -2.76, -4.609, 0.256, 0.7162, 0.008391,
    0.05723,
])
# fmt: on


def confidence(around: Surroundings, weights: FloatArray) -> FloatArray:
    """Probability (C,) that a cluster with these surroundings is an obstacle."""
    return np.asarray(1.0 / (1.0 + np.exp(-(weights[0] + features(around) @ weights[1:]))))


def features(around: Surroundings) -> FloatArray:
    """What the confidence is made of (C, 20): evidence, sizes, how the road lies around, and range."""
    share = np.clip(around.side_mean_m / around.relief_m[:, None], -1.0, 1.0)
    count, relief = np.log(around.count), np.log(around.relief_m)
    range_m = np.log(np.maximum(around.range_m, 3.0))
    along, across = np.clip(around.extent_along_m, 0.0, 4.0), np.clip(around.extent_across_m, 0.0, 4.0)
    sides = np.log1p(np.clip(around.side_count, 0.0, 5.0))
    columns = (
        np.log(around.evidence),
        count,
        relief,
        around.count / around.inner,
        share[:, :2].max(axis=1),
        share[:, 2:].max(axis=1),
        share[:, 2:].min(axis=1),
        np.abs(share).sum(axis=1),
        sides[:, 2:].min(axis=1),
        sides[:, :2].min(axis=1),
        np.clip(around.edge_m, 0.0, 0.5),
        range_m,
        count * range_m,
        relief * range_m,
        along,
        across,
        np.log((across + 0.1) / (along + 0.1)),
        np.log(around.peak_m / around.relief_m),
        np.log((across + 0.05) / around.gap_m),
        np.clip(count - np.log(np.maximum(around.density_per_m2, 0.1)), -6.0, 1.0),
    )
    return np.stack(columns, axis=1)
