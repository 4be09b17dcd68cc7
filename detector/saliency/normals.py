"""Normals of points, both ways: the mean of the face normals around a point, and the normal of its plane (PCA)."""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from detector.arrays import FloatArray
from detector.threads import in_chunks

# Coordinates in float32 or float64, rows in any integer.
Points = TypeVar("Points", NDArray[np.float32], NDArray[np.float64])
Neighbours = NDArray[np.signedinteger]

# Where a face stands upright, z alone does not orient its normal; y and then x decide with these weights.
UP = (1e-3, 2e-3, 1.0)
# A sliver's normal is noise: faces with less than this sine between their edges are left out.
MIN_FACE_SINE = 1e-6
# Newton's steps double the digits: after one of this share of the root twelve are right. Steps are spent where two
# eigenvalues are equal.
LAST_NEWTON_STEP = 1e-6
MAX_NEWTON_STEPS = 30


def pca_normals(points_m: Points, neighbours: Neighbours) -> Points:
    """Unit normals (N, 3), oriented to +z, of the least-squares planes through each point's neighbourhood (N, K).

    They have the points' precision: float32 suffices where coordinates are about the cloud's centre.
    """
    normals = np.empty_like(points_m)
    in_chunks(lambda start, stop: _pca(points_m, neighbours, start, stop, normals), len(neighbours), len(neighbours))
    return normals


def face_normals(points_m: Points, neighbours: Neighbours) -> Points:
    """Unit normals (N, 3), oriented to +z, as the mean of the normals of the faces around each point (Eqs. 1 and 2).

    A cloud has no faces; they are a fan of triangles of the point with each two consecutive neighbours (N, K), in the
    order of their angle about the point in its PCA plane. Eq. 1: n_f = (v2 - v1) x (v3 - v1) / |...|; Eq. 2: the mean
    of n_f over the faces of the neighbourhood, scaled to unit length.
    """
    normals = _fan(points_m.astype(np.float64), neighbours, pca_normals(points_m, neighbours).astype(np.float64))
    downward = normals @ np.array(UP) < 0.0
    normals[downward] *= -1.0
    return np.asarray(normals, dtype=points_m.dtype)


@njit(cache=True, nogil=True, fastmath=True)
def _pca(points: Points, neighbours: Neighbours, start: int, stop: int, normals: Points) -> None:
    k = neighbours.shape[1]
    for i in range(start, stop):
        # About the point itself, so that squares of coordinates do not swallow the neighbourhood's.
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        sx = sy = sz = xx = yy = zz = xy = xz = yz = px - px
        for j in range(k):
            p = neighbours[i, j]
            x, y, z = points[p, 0] - px, points[p, 1] - py, points[p, 2] - pz
            sx, sy, sz = sx + x, sy + y, sz + z
            xx, yy, zz = xx + x * x, yy + y * y, zz + z * z
            xy, xz, yz = xy + x * y, xz + x * z, yz + y * z
        mx, my, mz = sx / k, sy / k, sz / k
        normals[i] = _flattest_direction(
            xx - sx * mx, yy - sy * my, zz - sz * mz, xy - sx * my, xz - sx * mz, yz - sy * mz
        )


@njit(cache=True, nogil=True, fastmath={"contract"})
def _flattest_direction(a: float, b: float, c: float, d: float, e: float, f: float) -> tuple[float, float, float]:
    """Unit eigenvector, oriented to +z, of the least eigenvalue of the scatter [[a, d, e], [d, b, f], [e, f, c]].

    Scaled to a trace of 1 its characteristic polynomial t^3 - t^2 + q t - r has three roots in [0, 1], and Newton's
    method from 0 climbs to the least.
    """
    trace = a + b + c
    if not trace > 0.0:
        return 0.0, 0.0, 1.0
    unit = 1.0 / trace
    a, b, c, d, e, f = a * unit, b * unit, c * unit, d * unit, e * unit, f * unit
    q = a * b + a * c + b * c - d * d - e * e - f * f
    r = a * (b * c - f * f) - d * (d * c - e * f) + e * (d * f - b * e)
    root = 0.0
    for _ in range(MAX_NEWTON_STEPS):
        slope = (3.0 * root - 2.0) * root + q
        step = (r - ((root - 1.0) * root + q) * root) / slope if slope > 0.0 else 0.0
        root += step
        if step <= LAST_NEWTON_STEP * root:
            break
    a, b, c = a - root, b - root, c - root
    # The cross product of two independent rows of A - root I is orthogonal to both: the longest of three is taken.
    x, y, z = d * f - e * b, e * d - a * f, a * b - d * d
    length = x * x + y * y + z * z
    u, v, w = d * c - e * f, e * e - a * c, a * f - e * d
    if u * u + v * v + w * w > length:
        x, y, z, length = u, v, w, u * u + v * v + w * w
    u, v, w = b * c - f * f, f * e - d * c, d * f - b * e
    if u * u + v * v + w * w > length:
        x, y, z, length = u, v, w, u * u + v * v + w * w
    if length < 1e-24:
        return 0.0, 0.0, 1.0
    scale = (1.0 if UP[0] * x + UP[1] * y + UP[2] * z >= 0.0 else -1.0) / math.sqrt(length)
    return x * scale, y * scale, z * scale


@njit(cache=True, nogil=True)
def _fan(points: FloatArray, neighbours: Neighbours, plane_normals: FloatArray) -> FloatArray:
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
