"""How likely a cluster is an obstacle: a logistic model of what lies in and around it."""

from __future__ import annotations

import numpy as np

from detector.clusters import Surroundings
from detector.types import FloatArray

# Less is not reported.
MIN_CONFIDENCE = 0.6

# Intercept and weights of `features`, fitted to simulated drives by `python -m evaluation.fit_confidence`: of the
# clusters of one sweep, and of those in the grid of several.
# fmt: off
HOLE_WEIGHTS = np.array([
    0.9218, 1.085, 0.1307, 4.167, 1.494, -2.614, -3.443, -1.752, -3.469, 5.251,
    1.602, -10.42, -0.1205, -0.345, -0.5516, 0.1146, -5.482, 1.134, 7.065, -0.4183,
    -0.1756,
])
RISE_WEIGHTS = np.array([
    -6.647, 1.179, 0.2906, 1.84, 1.95, -6.181, 0.3447, -5.258, -2.894, 4.071,
    2.122, 2.839, -0.07944, -0.4279, -0.08455, -1.404, -1.821, 0.7836, 3.104, -0.2235,
    0.8514,
])
GRID_HOLE_WEIGHTS = np.array([
    -24.46, 0.8745, 2.569, -3.292, 1.938, -2.927, -6.043, -0.3758, -3.075, 0.1504,
    3.527, 6.801, -2.122, -0.02484, -0.07012, -1.648, -4.091, -1.788, 2.204, 0.4637,
    -1.159,
])
GRID_RISE_WEIGHTS = np.array([
    -22.2, 2.068, 1.941, -2.287, 0.5699, -7.297, 0.3348, -2.386, -1.948, 1.186,
    -0.4817, 4.29, -0.08262, -0.116, 0.1715, -2.738, -4.386, 0.298, 1.731, 0.151,
    -0.5046,
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
