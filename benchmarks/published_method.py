"""The published method's saliency map, written down plainly: the reference that ours is timed and scored against.

One point after the other, as the method is described: neighbours from a kd-tree, the normal from an eigendecomposition
of its neighbourhood, the spectral saliency from another, the geometric one from robust PCA with a full singular value
decomposition in each step. The paper's appendix solves that by alternating minimisation; augmented Lagrange multipliers
(ALM), the usual way, are here too.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

FloatArray = NDArray[np.float64]

NEIGHBOURS = 30


def published_saliency(
    points_m: FloatArray, robust_pca: Callable[[FloatArray], FloatArray], neighbours: int = NEIGHBOURS
) -> FloatArray:
    """Saliency (N,) in [0, 1] of points (N, 3): mean of the geometric and the spectral one, each scaled to [0, 1].

    `robust_pca` gives the sparse part S of the matrix E (N, 3 (k + 1)) of normals.
    """
    _, nearest = cKDTree(points_m).query(points_m, k=neighbours + 1)
    normals = np.array([_normal(points_m[row]) for row in nearest])
    around = normals[nearest]
    spectral = np.array([_spectral(of_one) for of_one in around])
    S = robust_pca(around.reshape(len(around), -1))
    geometric = np.array([np.linalg.norm(row[:3]) for row in S])
    return 0.5 * _scaled(geometric) + 0.5 * _scaled(spectral)


def alternating_minimisation(E: FloatArray, epsilon: float = 0.01, iterations: int = 3) -> FloatArray:
    """S of E = L + S by the paper's appendix (Rodriguez and Wohlberg, ICIP 2013, Algorithm 1), lambda = 1/sqrt(3 N).

    L is the decomposition's part of rank r, which grows while its last singular value is more than `epsilon` of all.
    """
    lam, rank = 1.0 / np.sqrt(3.0 * len(E)), 1
    S = np.zeros_like(E)
    for _ in range(iterations):
        U, sigma, Vt = np.linalg.svd(E - S, full_matrices=False)
        L = (U[:, :rank] * sigma[:rank]) @ Vt[:rank]
        S = _shrunk(E - L, lam)
        if sigma[rank - 1] > epsilon * sigma[:rank].sum():
            rank += 1
    return S


def augmented_lagrange_multipliers(E: FloatArray, tolerance: float = 1e-3, iterations: int = 100) -> FloatArray:
    """S of E = L + S by Z. Lin, M. Chen and Y. Ma, "The augmented Lagrange multiplier method for exact recovery of
    corrupted low-rank matrices", 2010, Algorithm 5 with its own parameters but the tolerance (theirs, 1e-7, takes
    three times as long), lambda = 1/sqrt(N)."""
    lam, size, largest = 1.0 / np.sqrt(len(E)), np.linalg.norm(E), np.linalg.norm(E, 2)
    Y = E / max(largest, np.abs(E).max() / lam)
    S = np.zeros_like(E)
    penalty = 1.25 / largest
    for _ in range(iterations):
        U, sigma, Vt = np.linalg.svd(E - S + Y / penalty, full_matrices=False)
        L = (U * np.maximum(sigma - 1.0 / penalty, 0.0)) @ Vt
        S = _shrunk(E - L + Y / penalty, lam / penalty)
        left = E - L - S
        Y = Y + penalty * left
        penalty *= 1.5
        if np.linalg.norm(left) < tolerance * size:
            break
    return S


def _normal(neighbourhood_m: FloatArray) -> FloatArray:
    offsets = neighbourhood_m - neighbourhood_m.mean(axis=0)
    _, vectors = np.linalg.eigh(offsets.T @ offsets)
    return np.asarray(vectors[:, 0] if vectors[2, 0] >= 0.0 else -vectors[:, 0])


def _spectral(normals: FloatArray) -> float:
    return float(1.0 / np.linalg.norm(np.linalg.eigvalsh(normals.T @ normals)))


def _shrunk(X: FloatArray, threshold: float) -> FloatArray:
    return np.asarray(np.sign(X) * np.maximum(np.abs(X) - threshold, 0.0))


def _scaled(values: FloatArray) -> FloatArray:
    return np.asarray((values - values.min()) / np.ptp(values))
