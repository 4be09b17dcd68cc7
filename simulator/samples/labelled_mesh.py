"""Closed meshes whose vertices say what they belong to: what is written to files for other programs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from simulator.shapes.debris import Debris
from simulator.shapes.relief import Material, MaterialArray

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

SAME_VERTEX_DECIMALS = 7
"""Vertices that agree to a tenth of a micrometre are one."""


@dataclass(frozen=True, slots=True)
class LabelledMesh:
    """Triangles with outward normals, and what is known of each vertex.

    `vertices_m` (V, 3); `triangles` (T, 3) counter-clockwise from outside; `label` (V,) uint8, 1 on the obstacle;
    `material` (V,) uint8 of `Material`; `uv` (V, 2) in [0, 1], v upwards, or None for what has no texture.
    """

    vertices_m: FloatArray
    triangles: IndexArray
    label: NDArray[np.uint8]
    material: MaterialArray
    uv: FloatArray | None = None


def debris_mesh(debris: Debris) -> LabelledMesh:
    """A thing's mesh with one vertex a place and all of its solids turned outwards."""
    places, inverse = np.unique(
        np.round(debris.mesh.vertices_m, SAME_VERTEX_DECIMALS) + 0.0, axis=0, return_inverse=True
    )
    triangles = inverse.reshape(-1)[debris.mesh.triangles]
    a, b, c = triangles.T
    triangles = _outward(places, triangles[(a != b) & (b != c) & (c != a)])
    label = np.ones(len(places), dtype=np.uint8)
    return LabelledMesh(places, triangles, label, label * np.uint8(Material.DEBRIS))


def _outward(vertices_m: FloatArray, triangles: IndexArray) -> IndexArray:
    """The triangles of closed solids, each solid's turned so that its volume is positive."""
    import open3d as o3d  # heavy: only those who write meshes wait for it

    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices_m), o3d.utility.Vector3iVector(triangles.astype(np.int32))
    )
    mesh.orient_triangles()
    turned = np.asarray(mesh.triangles).astype(np.int64)
    a, b, c = turned.T
    links = coo_array((np.ones(2 * len(a)), (np.r_[a, b], np.r_[b, c])), shape=(len(vertices_m),) * 2)
    _, solid = connected_components(links, directed=False)
    corners = vertices_m[turned]
    volumes = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    inside_out = np.bincount(solid[a], volumes) < 0
    return np.where(inside_out[solid[a]][:, None], turned[:, ::-1], turned)
