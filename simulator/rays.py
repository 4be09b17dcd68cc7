"""Ray casting into triangle meshes by Open3D's Embree scene, as plain arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from simulator.mesh import Mesh

Float32Array = NDArray[np.float32]

NO_GEOMETRY = np.uint32(0xFFFF_FFFF)
"""What Embree calls a miss."""


@dataclass(frozen=True, slots=True)
class RayHits:
    """Where N rays ended: distance in units of the direction (inf: nowhere), and on which mesh (`NO_GEOMETRY`).

    `normal` (N, 3) is the triangle's, of unit length; `uv` (N, 2) lies at (1 - u - v) a + u b + v c of `triangle`.
    """

    distance: Float32Array
    geometry: NDArray[np.uint32]
    normal: Float32Array
    triangle: NDArray[np.uint32]
    uv: Float32Array


class RayScene:
    """Meshes in one frame, numbered in their order."""

    def __init__(self, meshes: Sequence[Mesh]) -> None:
        self._scene = o3d.t.geometry.RaycastingScene()
        for mesh in meshes:
            vertices, triangles = mesh.vertices_m.astype(np.float32), mesh.triangles.astype(np.uint32)
            self._scene.add_triangles(_tensor(vertices), _tensor(triangles))

    def cast(self, origins_m: Float32Array, directions: Float32Array) -> RayHits:
        """First hits of rays from (N, 3) or (3,) origins along (N, 3) directions."""
        answer = self._scene.cast_rays(_rays(origins_m, directions))
        return RayHits(
            distance=answer["t_hit"].numpy(),
            geometry=answer["geometry_ids"].numpy(),
            normal=answer["primitive_normals"].numpy(),
            triangle=answer["primitive_ids"].numpy(),
            uv=answer["primitive_uvs"].numpy(),
        )

    def blocked(self, origins_m: Float32Array, directions: Float32Array) -> NDArray[np.bool_]:
        """Whether anything lies on each ray (N,)."""
        return np.asarray(self._scene.test_occlusions(_rays(origins_m, directions)).numpy())


def _rays(origins_m: Float32Array, directions: Float32Array) -> o3d.core.Tensor:
    rays = np.empty((len(directions), 6), dtype=np.float32)
    rays[:, :3], rays[:, 3:] = origins_m, directions
    return _tensor(rays)


def _tensor(array: Any) -> o3d.core.Tensor:  # Open3D's stubs know no typed arrays
    tensor: o3d.core.Tensor = o3d.core.Tensor.from_numpy(array)
    return tensor
