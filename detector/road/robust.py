"""Robust fits shared by the road surface and the surface around one obstacle."""

from __future__ import annotations

import numpy as np
from numba import njit

from detector.arrays import FloatArray

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
    terms, values = np.ascontiguousarray(terms), np.ascontiguousarray(values)
    return np.asarray(_fit(terms, values, weight, cutoff_sd, floor_sd), dtype=np.float64)


@njit(cache=True, nogil=True)
def _fit(terms: FloatArray, values: FloatArray, weight: FloatArray, cutoff_sd: float, floor_sd: float) -> FloatArray:
    coefficients: FloatArray = _solve(terms, values, _rows_times(terms, weight))
    for _ in range(START_ITERATIONS):
        weighted = _weighted_by_deviation(terms, values, terms @ coefficients, weight, floor_sd)
        coefficients = _solve(terms, values, weighted)
    for _ in range(TUKEY_ITERATIONS):
        weighted = _weighted_by_tukey(terms, values, terms @ coefficients, weight, cutoff_sd, floor_sd)
        coefficients = _solve(terms, values, weighted)
    return coefficients


@njit(cache=True, nogil=True)
def _solve(terms: FloatArray, values: FloatArray, weighted: FloatArray) -> FloatArray:
    """Coefficients (T,) of the least squares whose rows (N, T) are `weighted`."""
    normal = weighted.T @ terms
    # A trace of ridge keeps degenerate layouts (one scan line) solvable.
    ridge = 1e-9 * max(np.trace(normal), 1e-12)
    for i in range(len(normal)):
        normal[i, i] += ridge
    return np.asarray(np.linalg.solve(normal, weighted.T @ values), dtype=np.float64)


@njit(cache=True, nogil=True)
def _weighted_by_deviation(
    terms: FloatArray, values: FloatArray, fitted: FloatArray, weight: FloatArray, floor_sd: float
) -> FloatArray:
    """Terms (N, T) with the weights of least absolute deviations."""
    deviation = np.abs(values - fitted)
    return np.asarray(_rows_times(terms, weight / np.maximum(deviation, floor_sd)))


@njit(cache=True, nogil=True)
def _weighted_by_tukey(
    terms: FloatArray, values: FloatArray, fitted: FloatArray, weight: FloatArray, cutoff_sd: float, floor_sd: float
) -> FloatArray:
    """Terms (N, T) with Tukey's weights."""
    residual = values - fitted
    cutoff = cutoff_sd * max(MAD_TO_SD * np.median(np.abs(residual)), floor_sd)
    share = np.maximum(1.0 - np.square(residual / cutoff), 0.0)
    return np.asarray(_rows_times(terms, weight * (share * share)))


@njit(cache=True, nogil=True)
def _rows_times(terms: FloatArray, weight: FloatArray) -> FloatArray:
    weighted = np.empty_like(terms)
    for i in range(len(terms)):
        for k in range(terms.shape[1]):
            weighted[i, k] = terms[i, k] * weight[i]
    return weighted
