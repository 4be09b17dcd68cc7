"""The paper's saliency of a point cloud: geometric (RPCA) and spectral, each scaled to [0, 1], and their mean."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from detector.arrays import Float32Array, FloatArray
from detector.neighbours.nearest import find_neighbourhoods
from detector.saliency.normals import face_normals, pca_normals
from detector.saliency.rpca import decompose, default_lambda
from detector.saliency.spectral import inverse_frobenius_and_sum

# Neighbours of a point (k).
NEIGHBOURS = 30
# Weights of geometric and spectral saliency.
WEIGHTS = (0.5, 0.5)
# The authors' published rule: salient above 10 of 64 colours.
SALIENT = 10.0 / 64.0
# Sums over a neighbourhood differ by some units in the last place where all normals are equal.
EQUAL_ROUNDINGS = 100.0


def saliency_map(points_m: FloatArray, neighbours: int = NEIGHBOURS, *, from_faces: bool = False) -> FloatArray:
    """Saliency (N,) in [0, 1] of points (N, 3): weighted mean of the two saliencies, each scaled over the cloud.

    `from_faces` takes the mean of face normals (Eqs. 1 and 2) instead of the PCA's. The geometric part is that of
    `swift_geometric_saliency`; to tell zero from more take `geometric_saliency`. Raises DetectorError for coordinates
    that are not finite.
    """
    if len(points_m) <= neighbours:
        return np.zeros(len(points_m))
    cloud = find_neighbourhoods(points_m, neighbours + 1)
    normals = face_normals(cloud.points, cloud.nearest) if from_faces else pca_normals(cloud.points, cloud.nearest)
    spectral, total = inverse_frobenius_and_sum(normals, cloud.nearest)
    geometric = swift_geometric_saliency(normals, total, neighbours + 1)
    saliency = np.empty(len(points_m))
    saliency[cloud.order] = WEIGHTS[0] * scale_to_unit(geometric) + WEIGHTS[1] * scale_to_unit(spectral)
    return saliency


def geometric_saliency(around: FloatArray | Float32Array) -> FloatArray:
    """s1 (N,): norm of the first three values of each row of S, those of the point's own normal.

    `around` (N, k + 1, 3) are the normals of each point, its own first, and its neighbours; a row of E is one
    neighbourhood.
    """
    E = around.reshape(len(around), -1).astype(np.float32)
    _, S = decompose(E, default_lambda(len(E)))
    return np.asarray(np.linalg.norm(S[:, :3].astype(np.float64), axis=1))


def swift_geometric_saliency(normals: Float32Array, total: Float32Array, count: int) -> Float32Array:
    """`geometric_saliency` (N,) in one pass: unit normals (N, 3) and their sums (N, 3) over `count` points each.

    The threshold lambda is small, so after its first step E - S is L but for entries no greater than lambda, and the
    scheme stays there: L is the best approximation of E of rank one, to within lambda. Its right singular vector
    weighs all neighbours alike, as they come in no order; then a row of E counts only by the point's own normal and the
    sum of the others, and the 3 (k + 1) columns are six.
    """
    scale = np.float32(1.0 / math.sqrt(count - 1))
    own, cross, sums = (normals.T @ normals, normals.T @ total, total.T @ total)
    among_others = scale * (cross - own)
    gram = np.block([[own, among_others], [among_others.T, scale * scale * (sums - cross - cross.T + own)]])
    _, vectors = np.linalg.eigh(gram.astype(np.float64))
    leading = vectors[:, -1].astype(np.float32)
    coefficient = normals @ (leading[:3] - scale * leading[3:]) + total @ (scale * leading[3:])
    return np.asarray(_sparse_length(normals, coefficient, leading[:3], np.float32(default_lambda(len(normals)))))


@njit(cache=True, nogil=True)
def _sparse_length(
    normals: Float32Array, coefficient: Float32Array, axis: Float32Array, lam: np.float32
) -> Float32Array:
    """Lengths (N,) of what the soft threshold leaves of the normals (N, 3) without their part along `axis` (3,)."""
    lengths = np.empty_like(coefficient)
    for i in range(lengths.size):
        square = np.float32(0.0)
        for k in range(3):
            left = max(abs(normals[i, k] - coefficient[i] * axis[k]) - lam, np.float32(0.0))
            square += left * left
        lengths[i] = math.sqrt(square)
    return lengths


def scale_to_unit(values: FloatArray | Float32Array) -> FloatArray:
    """Values (N,) mapped linearly so that the least is 0 and the greatest 1; equal values (to rounding) become 0."""
    low, span = float(values.min()), float(np.ptp(values))
    if span <= EQUAL_ROUNDINGS * float(np.finfo(values.dtype).eps) * abs(low):
        return np.zeros(len(values))
    return np.asarray((values - low) / span, dtype=np.float64)
