"""Spectral saliency on its absolute scale: how much the normals of a neighbourhood differ."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from detector.arrays import Float32Array, FloatArray
from detector.neighbours.nearest import find_neighbourhoods
from detector.threads import in_chunks

NEIGHBOURS = 8


def inverse_frobenius(normals: FloatArray) -> FloatArray:
    """1 / ||E_j E_j^T||_F (N,) of the unit normals (N, K, 3) of neighbourhoods, E_j the (3, K) matrix of one.

    This is the paper's inverse l2 norm of the eigenvalues of R_j = E_j E_j^T: R_j is symmetric, so the squares of its
    eigenvalues sum to the squares of its entries, and no eigendecomposition is needed.
    """
    scatter = np.einsum("nki,nkj->nij", normals, normals)
    return np.asarray(1.0 / np.maximum(np.sqrt(np.einsum("nij,nij->n", scatter, scatter)), 1e-12))


def inverse_frobenius_and_sum(normals: Float32Array, nearest: NDArray[np.int32]) -> tuple[Float32Array, Float32Array]:
    """`inverse_frobenius` (N,) of unit normals (N, 3) over the rows `nearest` (N, K), and the sums (N, 3) of those.

    Both in one pass: that over the neighbours' normals is what takes the time.
    """
    inverse, total = np.empty(len(nearest), dtype=np.float32), np.empty_like(normals)
    in_chunks(lambda start, stop: _spread(normals, nearest, start, stop, inverse, total), len(nearest), len(nearest))
    return inverse, total


@njit(cache=True, nogil=True, fastmath=True)
def _spread(
    normals: Float32Array,
    nearest: NDArray[np.int32],
    start: int,
    stop: int,
    inverse: Float32Array,
    total: Float32Array,
) -> None:
    for i in range(start, stop):
        sx = sy = sz = xx = yy = zz = xy = xz = yz = np.float32(0.0)
        for j in range(nearest.shape[1]):
            x, y, z = normals[nearest[i, j]]
            sx, sy, sz = sx + x, sy + y, sz + z
            xx, yy, zz = xx + x * x, yy + y * y, zz + z * z
            xy, xz, yz = xy + x * y, xz + x * z, yz + y * z
        squares = xx * xx + yy * yy + zz * zz + np.float32(2.0) * (xy * xy + xz * xz + yz * yz)
        inverse[i] = np.float32(1.0) / math.sqrt(squares)
        total[i, 0], total[i, 1], total[i, 2] = sx, sy, sz


def absolute_scale(normals: FloatArray) -> FloatArray:
    """K / ||R||_F (N,): 1 on a plane, sqrt(3) where the normals (N, K, 3) point everywhere; the same for every car."""
    return np.asarray(normals.shape[1] * inverse_frobenius(normals))


def absolute_saliency(points_m: FloatArray) -> float:
    """Saliency of a few points (N, 3) taken as one neighbourhood of the normals of its local planes."""
    if len(points_m) < NEIGHBOURS:
        return 1.0
    cloud = find_neighbourhoods(points_m, NEIGHBOURS)
    around = cloud.points[cloud.nearest].astype(np.float64)
    offsets = around - around.mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))
    return float(absolute_scale(vectors[None, :, :, 0])[0])
