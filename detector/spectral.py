"""Spectral saliency on its absolute scale: how much the normals of a neighbourhood differ."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from detector.types import FloatArray

NEIGHBOURS = 8


def inverse_frobenius(normals: FloatArray) -> FloatArray:
    """1 / ||E_j E_j^T||_F (N,) of the unit normals (N, K, 3) of neighbourhoods, E_j the (3, K) matrix of one.

    This is the paper's inverse l2 norm of the eigenvalues of R_j = E_j E_j^T: R_j is symmetric, so the squares of its
    eigenvalues sum to the squares of its entries, and no eigendecomposition is needed.
    """
    scatter = np.einsum("nki,nkj->nij", normals, normals)
    return np.asarray(1.0 / np.maximum(np.sqrt(np.einsum("nij,nij->n", scatter, scatter)), 1e-12))


def absolute_scale(normals: FloatArray) -> FloatArray:
    """K / ||R||_F (N,): 1 on a plane, sqrt(3) where the normals (N, K, 3) point everywhere; the same for every car."""
    return np.asarray(normals.shape[1] * inverse_frobenius(normals))


def absolute_saliency(points_m: FloatArray) -> float:
    """Saliency of a few points (N, 3) taken as one neighbourhood of the normals of its local planes."""
    if len(points_m) < NEIGHBOURS:
        return 1.0
    _, neighbours = cKDTree(points_m).query(points_m, k=NEIGHBOURS)
    offsets = points_m[neighbours] - points_m[neighbours].mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))
    return float(absolute_scale(vectors[None, :, :, 0])[0])
