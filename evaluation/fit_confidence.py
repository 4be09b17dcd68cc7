"""Fits the detector's confidence to simulated drives: `python -m evaluation.fit_confidence` prints the weights.

They go into `detector/obstacles/confidence.py`. The seeds here are used for nothing else; `headsup evaluate lidar`
takes others.
"""

from __future__ import annotations

import sys
from collections import defaultdict

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from evaluation.lidar_candidates import Sample, samples
from evaluation.lidar_course import course, drive, presets
from simulator.streets.street import Roughness

FloatArray = NDArray[np.float64]

FIT_SEEDS = tuple(range(1001, 1013))
RANGE_SD_M = 0.02
# Speeds in km/h, one for each seed in turn.
SPEEDS_KPH = (50.0, 50.0, 30.0)
SENSORS_A_SEED = 1
NAMES = {
    (True, False): "HOLE_WEIGHTS",
    (False, False): "RISE_WEIGHTS",
    (True, True): "GRID_HOLE_WEIGHTS",
    (False, True): "GRID_RISE_WEIGHTS",
}
# Standard deviations of the standardised weights: keeps what the drives do not show from growing.
RIDGE = 3.0
ITERATIONS = 40


def logistic_weights(values: FloatArray, is_true: NDArray[np.bool_]) -> FloatArray:
    """Intercept and weights (F + 1,) of the ridge logistic regression of `is_true` (N,) on `values` (N, F)."""
    mean, sd = values.mean(axis=0), values.std(axis=0) + 1e-9
    terms = np.concatenate([np.ones((len(values), 1)), (values - mean) / sd], axis=1)
    ridge = RIDGE * np.diag(np.r_[0.0, np.ones(values.shape[1])])
    weights = np.zeros(terms.shape[1])
    for _ in range(ITERATIONS):
        probability = 1.0 / (1.0 + np.exp(-np.clip(terms @ weights, -30.0, 30.0)))
        gradient = terms.T @ (is_true - probability) - ridge @ weights
        curvature = (terms * (probability * (1.0 - probability))[:, None]).T @ terms + ridge + 1e-9 * np.eye(len(ridge))
        weights += np.linalg.solve(curvature, gradient)
    slope = weights[1:] / sd
    return np.asarray(np.r_[weights[0] - slope @ mean, slope])


def main() -> None:
    """Drive, fit and print."""
    names = list(presets(RANGE_SD_M))
    drives = [(seed, names[(seed + k) % len(names)]) for seed in FIT_SEEDS for k in range(SENSORS_A_SEED)]
    collected: dict[tuple[bool, bool], list[Sample]] = defaultdict(list)
    for seed, name in track(drives, "driving", console=Console(stderr=True)):
        on = course(seed, Roughness.B if seed % 2 else Roughness.C)
        speed_mps = SPEEDS_KPH[seed % len(SPEEDS_KPH)] / 3.6
        for sample in samples(on, drive(on, presets(RANGE_SD_M)[name], seed, speed_mps)):
            collected[sample.is_negative, sample.over_frames].append(sample)
    for key, name in NAMES.items():
        values = np.concatenate([sample.features for sample in collected[key]])
        is_obstacle = np.concatenate([sample.is_obstacle for sample in collected[key]])
        print(f"# {is_obstacle.sum()} obstacles, {(~is_obstacle).sum()} others", file=sys.stderr)
        weights = [f"{weight:.4g}" for weight in logistic_weights(values, is_obstacle)]
        rows = [", ".join(weights[i : i + 10]) for i in range(0, len(weights), 10)]
        print(f"{name} = np.array([\n" + "".join(f"    {row},\n" for row in rows) + "])")


if __name__ == "__main__":
    main()
