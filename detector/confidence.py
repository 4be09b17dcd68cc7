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
    -13.25, 2.069, 0.778, 2.83, 3.514, -7.866, -5.627, -0.6036, -1.449, 4.354,
    -0.4908, 0.2919, -0.509, -0.5991, -0.7116, 0.1104, -2.754, 1.471, 7.342, -0.5116,
    -1.041,
])
RISE_WEIGHTS = np.array([
    -12.8, 1.879, 1.008, 2.448, 1.387, -7.839, 0.4591, -3.296, -2.718, 3.734,
    2.504, -0.08419, 0.7345, -0.7069, -0.467, -1.405, -2.221, 0.6745, 6.702, 0.1612,
    0.5612,
])
GRID_HOLE_WEIGHTS = np.array([
    -15.73, 0.7537, 1.026, -3.95, 2.235, -5.857, -5.444, -0.0259, -2.262, -0.3955,
    2.284, 12.05, -2.732, -0.04523, 0.188, -0.3416, -3.377, -1.989, 1.785, 1.07,
    0.273,
])
GRID_RISE_WEIGHTS = np.array([
    -22.25, 2.449, 1.198, -2.917, 0.6592, -11.3, 1.411, 0.7908, -1.112, 1.311,
    -0.08397, 4.621, -0.5578, -0.003405, 0.3967, -2.272, -5.611, 0.6119, 0.8108, 0.1428,
    -0.08174,
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
