"""Named numbers of a shape that survive rotation and a change of density."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from detector.arrays import FloatArray
from detector.types import ShapeDescriptor

NAME = "shape"
VERSION = 2
# The upper half of depths (heights): lower quantiles lie on the walls, where a pass differs most from the next (27 % at
# 10, 18 % at 25, 6 % at 90).
PROFILE_PERCENT = (50, 75, 90)


@dataclass(frozen=True, slots=True)
class Moments:
    """Area, centroid (2,) and central second moments per area (2, 2) of a polygon, metres."""

    area_m2: float
    centroid_m: FloatArray
    covariance_m2: FloatArray


def polygon_moments(outline_m: FloatArray) -> Moments:
    """Moments of a simple polygon (K, 2), open or closed, either orientation, by Green's theorem."""
    origin = outline_m.mean(axis=0)
    p = outline_m - origin
    q = np.roll(p, -1, axis=0)
    cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
    area = 0.5 * float(cross.sum())
    if abs(area) < 1e-12:
        return Moments(0.0, origin, np.zeros((2, 2)))
    centroid = ((p + q) * cross[:, None]).sum(axis=0) / (6.0 * area)
    square = (p * p + p * q + q * q) * cross[:, None] / 12.0
    mixed = (p[:, 0] * q[:, 1] + 2 * p[:, 0] * p[:, 1] + 2 * q[:, 0] * q[:, 1] + q[:, 0] * p[:, 1]) * cross / 24.0
    xy = float(mixed.sum())
    second = np.array([[square[:, 0].sum(), xy], [xy, square[:, 1].sum()]]) / area
    return Moments(abs(area), origin + centroid, second - np.outer(centroid, centroid))


def moment_box(moments: Moments) -> tuple[float, float, float]:
    """Length, width and yaw in [0, pi) of the ellipse with a polygon's second moments: axes 4 sqrt(eigenvalue)."""
    values, vectors = np.linalg.eigh(moments.covariance_m2)
    width, length = 4.0 * np.sqrt(np.maximum(values, 0.0))
    return float(length), float(width), fold_yaw(math.atan2(vectors[1, 1], vectors[0, 1]))


def fold_yaw(yaw_rad: float) -> float:
    """Direction of an undirected axis in [0, pi)."""
    folded = math.fmod(yaw_rad, math.pi)
    folded = folded + math.pi if folded < 0.0 else folded
    return 0.0 if folded >= math.pi else folded


def describe(
    outline_m: FloatArray,
    length_m: float,
    width_m: float,
    relief_m: FloatArray,
    volume_m3: float,
    saliency: FloatArray,
) -> ShapeDescriptor:
    """Descriptor of an outline (K, 2), samples (M,) of depth or height inside, and saliency on its absolute scale."""
    moments = polygon_moments(outline_m)
    edges = np.diff(outline_m, axis=0, append=outline_m[:1])
    values = {
        "length_m": length_m,
        "width_m": width_m,
        "area_m2": moments.area_m2,
        "perimeter_m": float(np.hypot(edges[:, 0], edges[:, 1]).sum()),
        "elongation": length_m / max(width_m, 1e-3),
        "relief_max_m": float(relief_m.max()),
        "relief_mean_m": float(relief_m.mean()),
        "volume_m3": volume_m3,
        **_profile(relief_m),
        **_hu_invariants(moments),
        "saliency_mean": float(saliency.mean()),
        "saliency_peak": float(np.percentile(saliency, 95)),
    }
    return ShapeDescriptor(NAME, VERSION, values)


def _profile(relief_m: FloatArray) -> dict[str, float]:
    quantiles = np.percentile(relief_m, PROFILE_PERCENT)
    return {f"relief_p{percent}_m": float(q) for percent, q in zip(PROFILE_PERCENT, quantiles, strict=True)}


def _hu_invariants(moments: Moments) -> dict[str, float]:
    """Hu's first moment invariant and the root of his second (Hu 1962): 1 / (2 pi) and 0 for a disc."""
    if moments.area_m2 <= 0.0:
        return {"hu1": 0.0, "hu2_root": 0.0}
    eta = moments.covariance_m2 / moments.area_m2
    difference = eta[0, 0] - eta[1, 1]
    return {"hu1": float(np.trace(eta)), "hu2_root": math.hypot(difference, 2.0 * eta[0, 1])}
