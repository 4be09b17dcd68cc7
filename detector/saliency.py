"""The paper's saliency of a point cloud: geometric (RPCA) and spectral, each scaled to [0, 1], and their mean."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from detector.normals import face_normals, pca_normals
from detector.rpca import decompose, default_lambda
from detector.spectral import inverse_frobenius
from detector.types import FloatArray

# Neighbours of a point (k).
NEIGHBOURS = 30
# Weights of geometric and spectral saliency.
WEIGHTS = (0.5, 0.5)
# The authors' published rule: salient above 10 of 64 colours.
SALIENT = 10.0 / 64.0


def saliency_map(points_m: FloatArray, neighbours: int = NEIGHBOURS, *, from_faces: bool = False) -> FloatArray:
    """Saliency (N,) in [0, 1] of points (N, 3): weighted mean of the two saliencies, each scaled over the cloud.

    `from_faces` takes the mean of face normals (Eqs. 1 and 2) instead of the PCA's.
    """
    if len(points_m) <= neighbours:
        return np.zeros(len(points_m))
    _, nearest = cKDTree(points_m).query(points_m, k=neighbours + 1)
    nearest = _self_first(np.asarray(nearest, dtype=np.int64))
    normals = face_normals(points_m, nearest[:, 1:]) if from_faces else pca_normals(points_m, nearest)
    around = normals[nearest]
    return WEIGHTS[0] * scale_to_unit(geometric_saliency(around)) + WEIGHTS[1] * scale_to_unit(
        inverse_frobenius(around)
    )


def geometric_saliency(around: FloatArray) -> FloatArray:
    """s1 (N,): norm of the first three values of each row of S, those of the point's own normal.

    `around` (N, k + 1, 3) are the normals of each point and its neighbours; a row of E is one neighbourhood.
    """
    E = around.reshape(len(around), -1).astype(np.float32)
    _, S = decompose(E, default_lambda(len(E)))
    return np.asarray(np.linalg.norm(S[:, :3].astype(np.float64), axis=1))


def scale_to_unit(values: FloatArray) -> FloatArray:
    """Values (N,) mapped linearly so that the least is 0 and the greatest 1; equal values (to rounding) become 0."""
    low, span = values.min(), np.ptp(values)
    if span <= 1e-9 * abs(low):
        return np.zeros_like(values)
    return np.asarray((values - low) / span)


def _self_first(nearest: np.ndarray) -> np.ndarray:
    """Column 0 the point itself also where points coincide and the tree returns a twin first."""
    own = np.arange(len(nearest))
    twin = nearest[:, 0] != own
    rows, columns = np.nonzero(nearest[twin] == own[twin, None])
    swapped = nearest[twin]
    swapped[rows, columns] = swapped[rows, 0]
    swapped[:, 0] = own[twin]
    nearest[twin] = swapped
    return nearest
