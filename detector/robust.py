"""Robust fits shared by the road surface and the surface around one obstacle."""

from __future__ import annotations

import numpy as np

from detector.types import FloatArray

# Makes the median absolute deviation of a normal distribution its standard deviation.
MAD_TO_SD = 1.4826
# Least absolute deviations first: a start that a third of outliers does not move.
START_ITERATIONS = 5
TUKEY_ITERATIONS = 6


def tukey_weight(residual: FloatArray, cutoff: float | FloatArray) -> FloatArray:
    """Tukey's biweight: 1 at no residual, 0 beyond `cutoff`."""
    return np.square(np.maximum(1.0 - np.square(residual / cutoff), 0.0))


def robust_sd(values: FloatArray) -> float:
    """Standard deviation about the median by the median absolute deviation; 0 for no values."""
    if values.size == 0:
        return 0.0
    return MAD_TO_SD * float(np.median(np.abs(values - np.median(values))))


def quadratic_terms(x: FloatArray, y: FloatArray) -> FloatArray:
    """Design matrix (N, 6) of a quadratic in two coordinates: 1, x, y, x^2, x y, y^2."""
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)


def fit_tukey(
    terms: FloatArray, values: FloatArray, weight: FloatArray, cutoff_sd: float, floor_sd: float
) -> FloatArray:
    """Coefficients (T,) of the robust fit of `terms` (N, T) to `values` (N,), with prior weights (N,).

    `cutoff_sd` is Tukey's constant in standard deviations of the residual, which is not taken below `floor_sd`.
    """
    coefficients = _solve(terms, values, weight)
    for _ in range(START_ITERATIONS):
        residual = np.abs(values - terms @ coefficients)
        coefficients = _solve(terms, values, weight / np.maximum(residual, floor_sd))
    for _ in range(TUKEY_ITERATIONS):
        residual = values - terms @ coefficients
        sd = max(MAD_TO_SD * float(np.median(np.abs(residual))), floor_sd)
        coefficients = _solve(terms, values, weight * tukey_weight(residual, cutoff_sd * sd))
    return coefficients


def _solve(terms: FloatArray, values: FloatArray, weight: FloatArray) -> FloatArray:
    weighted = terms * weight[:, None]
    normal = weighted.T @ terms
    # A trace of ridge keeps degenerate layouts (one scan line) solvable.
    normal[np.diag_indices_from(normal)] += 1e-9 * max(float(np.trace(normal)), 1e-12)
    return np.asarray(np.linalg.solve(normal, weighted.T @ values), dtype=np.float64)
