"""Normals of points, both ways: the mean of the face normals around a point, and the normal of its plane (PCA)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from detector.types import FloatArray, IntArray

# Where a face stands upright, z alone does not orient its normal; y and then x decide with these weights.
UP = np.array([1e-3, 2e-3, 1.0])
# A sliver's normal is noise: faces with less than this sine between their edges are left out.
MIN_FACE_SINE = 1e-6


def pca_normals(points_m: FloatArray, neighbours: IntArray) -> FloatArray:
    """Unit normals (N, 3), oriented to +z, of the least-squares planes through each point's neighbourhood (N, K)."""
    return np.asarray(_orient(_pca(points_m, neighbours)))


def face_normals(points_m: FloatArray, neighbours: IntArray) -> FloatArray:
    """Unit normals (N, 3), oriented to +z, as the mean of the normals of the faces around each point (Eqs. 1 and 2).

    A cloud has no faces; they are a fan of triangles of the point with each two consecutive neighbours (N, K), in the
    order of their angle about the point in its PCA plane. Eq. 1: n_f = (v2 - v1) x (v3 - v1) / |...|; Eq. 2: the mean
    of n_f over the faces of the neighbourhood, scaled to unit length.
    """
    return np.asarray(_orient(_fan(points_m, neighbours, _pca(points_m, neighbours))))


def _orient(normals: FloatArray) -> FloatArray:
    return normals * np.where(normals @ UP < 0.0, -1.0, 1.0)[:, None]


@njit(cache=True, nogil=True)
def _smallest_eigenvector(a: float, b: float, c: float, d: float, e: float, f: float) -> tuple[float, float, float]:
    """Eigenvector of the smallest eigenvalue of [[a, d, e], [d, b, f], [e, f, c]] in closed form (Smith, 1961)."""
    mean = (a + b + c) / 3.0
    p = math.sqrt(((a - mean) ** 2 + (b - mean) ** 2 + (c - mean) ** 2 + 2.0 * (d * d + e * e + f * f)) / 6.0)
    if p < 1e-15:
        return 0.0, 0.0, 1.0
    x, y, z = (a - mean) / p, (b - mean) / p, (c - mean) / p
    u, v, w = d / p, e / p, f / p
    half = 0.5 * (x * (y * z - w * w) - u * (u * z - w * v) + v * (u * w - y * v))
    angle = math.acos(min(1.0, max(-1.0, half))) / 3.0
    smallest = mean + 2.0 * p * math.cos(angle + 2.0 * math.pi / 3.0)
    a, b, c = a - smallest, b - smallest, c - smallest
    best = (0.0, 0.0, 0.0)
    length = 0.0
    # The cross product of two independent rows of A - lambda I is orthogonal to both: the longest of three is taken.
    for r in ((d * f - e * b, e * d - a * f, a * b - d * d), (d * c - e * f, e * e - a * c, a * f - e * d),
              (b * c - f * f, f * e - d * c, d * f - b * e)):  # fmt: skip
        square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
        if square > length:
            length, best = square, r
    if length < 1e-30:
        return 0.0, 0.0, 1.0
    scale = 1.0 / math.sqrt(length)
    return best[0] * scale, best[1] * scale, best[2] * scale


@njit(cache=True, nogil=True)
def _pca(points: FloatArray, neighbours: IntArray) -> FloatArray:
    normals = np.empty((neighbours.shape[0], 3))
    k = neighbours.shape[1]
    for i in range(neighbours.shape[0]):
        mx = my = mz = 0.0
        for j in range(k):
            p = neighbours[i, j]
            mx += points[p, 0]
            my += points[p, 1]
            mz += points[p, 2]
        mx, my, mz = mx / k, my / k, mz / k
        xx = yy = zz = xy = xz = yz = 0.0
        for j in range(k):
            p = neighbours[i, j]
            x, y, z = points[p, 0] - mx, points[p, 1] - my, points[p, 2] - mz
            xx += x * x
            yy += y * y
            zz += z * z
            xy += x * y
            xz += x * z
            yz += y * z
        normals[i] = _smallest_eigenvector(xx, yy, zz, xy, xz, yz)
    return normals


@njit(cache=True, nogil=True)
def _fan(points: FloatArray, neighbours: IntArray, plane_normals: FloatArray) -> FloatArray:
    normals = plane_normals.copy()
    k = neighbours.shape[1]
    angles = np.empty(k)
    for i in range(neighbours.shape[0]):
        n = plane_normals[i]
        axis = np.array([0.0, 0.0, 1.0]) if abs(n[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
        u = np.cross(axis, n)
        v = np.cross(n, u)
        for j in range(k):
            offset = points[neighbours[i, j]] - points[i]
            angles[j] = math.atan2(np.dot(offset, v), np.dot(offset, u))
        order = np.argsort(angles)
        total = np.zeros(3)
        for j in range(k):
            first = points[neighbours[i, order[j]]] - points[i]
            second = points[neighbours[i, order[(j + 1) % k]]] - points[i]
            face = np.cross(first, second)
            length = math.sqrt(np.dot(face, face))
            if length > MIN_FACE_SINE * math.sqrt(np.dot(first, first) * np.dot(second, second)):
                total += face / length
        size = math.sqrt(np.dot(total, total))
        if size > 1e-9:
            normals[i] = total / size
    return normals
