"""Robust PCA by fast alternating minimisation: the low-rank part of a tall matrix and the sparse rest.

Rodriguez and Wohlberg, "Fast Principal Component Pursuit via Alternating Minimization", ICIP 2013, Algorithm 1; the
paper's appendix uses the same scheme.
"""

from __future__ import annotations

import math

import numpy as np

from detector.arrays import Float32Array

ITERATIONS = 3
# The rank grows while the last singular value has more than this share of the sum.
EPSILON = 0.01


def default_lambda(rows: int) -> float:
    """1 / sqrt(3 rows): the threshold that reproduces the paper's Table I; larger ones empty S."""
    return 1.0 / math.sqrt(3.0 * max(rows, 1))


def decompose(
    E: Float32Array, lam: float, epsilon: float = EPSILON, iterations: int = ITERATIONS
) -> tuple[Float32Array, Float32Array]:
    """E (m, n), m >= n, as L + S + small rest: L of low rank, S sparse; both (m, n) float32.

    Each iteration takes L as the partial SVD of rank r of E - S, lets r grow by one while sigma_r / sum(sigma_1..r)
    exceeds `epsilon`, and takes S as the soft threshold of E - L at `lam`.
    """
    S = np.zeros_like(E)
    L = S
    rank = 1
    for _ in range(iterations):
        L, sigma = partial_svd(E - S, rank)
        S = soft_threshold(E - L, lam)
        if rank < E.shape[1] and sigma[-1] > epsilon * sigma.sum():
            rank += 1
    return L, S


def soft_threshold(X: Float32Array, lam: float) -> Float32Array:
    """Shrinkage sign(x) max(|x| - lam, 0), the proximal operator of the l1 norm."""
    return X - np.clip(X, -lam, lam)


def partial_svd(X: Float32Array, rank: int) -> tuple[Float32Array, Float32Array]:
    """Best approximation of X (m, n) of `rank`, and its singular values (rank,) in falling order.

    X V V^T, V the leading eigenvectors of the (n, n) Gram matrix X^T X: exact, and n is small.
    """
    values, vectors = np.linalg.eigh((X.T @ X).astype(np.float64))
    V = vectors[:, : -rank - 1 : -1].astype(np.float32)
    sigma = np.sqrt(np.maximum(values[: -rank - 1 : -1], 0.0)).astype(np.float32)
    return np.asarray((X @ V) @ V.T, dtype=np.float32), sigma
