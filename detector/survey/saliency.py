"""The paper's saliency on a survey: salient is what the sparse part of the RPCA keeps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detector.arrays import FloatArray
from detector.neighbours.nearest import find_neighbourhoods
from detector.saliency.cloud_saliency import NEIGHBOURS, WEIGHTS, geometric_saliency, scale_to_unit
from detector.saliency.normals import pca_normals
from detector.saliency.spectral import inverse_frobenius_and_sum


def salient_points(points_m: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Saliency (N,) in [0, 1] of points (N, 3), and which (N,) are salient: those whose row of S is not zero.

    With lambda = 1 / sqrt(3 N) this reproduces the paper's Table I; the fused map above a threshold finds rims only.
    """
    saliency, salient = np.zeros(len(points_m)), np.zeros(len(points_m), dtype=bool)
    if len(points_m) <= NEIGHBOURS:
        return saliency, salient
    cloud = find_neighbourhoods(points_m, NEIGHBOURS + 1)
    normals = pca_normals(cloud.points, cloud.nearest)
    spectral, _ = inverse_frobenius_and_sum(normals, cloud.nearest)
    geometric = geometric_saliency(normals[_own_first(cloud.nearest)])
    saliency[cloud.order] = WEIGHTS[0] * scale_to_unit(geometric) + WEIGHTS[1] * scale_to_unit(spectral)
    salient[cloud.order] = geometric > 0.0
    return saliency, salient


def _own_first(nearest: NDArray[np.int32]) -> NDArray[np.int32]:
    """Neighbourhoods (N, K) that begin with the point itself, however many others coincide with it."""
    own = np.arange(len(nearest), dtype=np.int32)
    ordered = nearest.copy()
    column = np.argmax(nearest == own[:, None], axis=1)
    ordered[own, column] = ordered[:, 0]
    ordered[:, 0] = own
    return ordered
