"""The paper's saliency on a survey: salient is what the sparse part of the RPCA keeps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from detector.normals import pca_normals
from detector.saliency import NEIGHBOURS, WEIGHTS, geometric_saliency, scale_to_unit
from detector.spectral import inverse_frobenius
from detector.types import FloatArray


def salient_points(points_m: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Saliency (N,) in [0, 1] of points (N, 3), and which (N,) are salient: those whose row of S is not zero.

    With lambda = 1 / sqrt(3 N) this reproduces the paper's Table I; the fused map above a threshold finds rims only.
    """
    if len(points_m) <= NEIGHBOURS:
        return np.zeros(len(points_m)), np.zeros(len(points_m), dtype=bool)
    local = points_m - points_m.mean(axis=0)
    _, nearest = cKDTree(local).query(local, k=NEIGHBOURS + 1)
    around = pca_normals(local, np.asarray(nearest, dtype=np.int64))[nearest]
    geometric = geometric_saliency(around)
    spectral = inverse_frobenius(around)
    return WEIGHTS[0] * scale_to_unit(geometric) + WEIGHTS[1] * scale_to_unit(spectral), geometric > 0.0
