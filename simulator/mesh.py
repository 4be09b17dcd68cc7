"""Triangle meshes as plain arrays, and the few solids that streets are made of."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Mesh:
    """Vertices (V, 3) in metres and triangles (T, 3) of vertex indices; both sides of a triangle are seen.

    What is drawn along a road carries distance s, offset t and height above the edge of its vertices, `road_m` (V, 3).
    """

    vertices_m: FloatArray
    triangles: IndexArray
    road_m: FloatArray | None = None

    def moved(self, a_from_b: FloatArray) -> Mesh:
        """The mesh of frame b in frame a, by a (4, 4) transform."""
        return replace(self, vertices_m=self.vertices_m @ a_from_b[:3, :3].T + a_from_b[:3, 3])

    def scaled(self, x: float, y: float, z: float) -> Mesh:
        """The mesh stretched along its axes."""
        return replace(self, vertices_m=self.vertices_m * np.array([x, y, z]))


def pose(
    x_m: float, y_m: float, z_m: float, yaw_rad: float = 0.0, pitch_rad: float = 0.0, roll_rad: float = 0.0
) -> FloatArray:
    """(4, 4) transform: turned by roll about x, then pitch about y (nose down), then yaw about z, then moved."""
    (cy, cp, cr), (sy, sp, sr) = np.cos([yaw_rad, pitch_rad, roll_rad]), np.sin([yaw_rad, pitch_rad, roll_rad])
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr, x_m],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr, y_m],
            [-sp, cp * sr, cp * cr, z_m],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def joined(meshes: list[Mesh]) -> Mesh:
    """One mesh of several; it carries road positions if all do."""
    offsets = np.cumsum([0] + [len(mesh.vertices_m) for mesh in meshes[:-1]])
    triangles = [mesh.triangles + offset for mesh, offset in zip(meshes, offsets, strict=True)]
    along = [mesh.road_m for mesh in meshes if mesh.road_m is not None]
    road_m = np.concatenate(along) if len(along) == len(meshes) else None
    return Mesh(np.concatenate([mesh.vertices_m for mesh in meshes]), np.concatenate(triangles), road_m)


def grid(vertices_m: FloatArray, road_m: FloatArray | None = None, cells: NDArray[np.bool_] | None = None) -> Mesh:
    """Surface through a (rows, columns, 3) lattice of vertices, two triangles a cell.

    `road_m` (rows, columns, 3) are positions along a road; only the chosen `cells` (rows - 1, columns - 1) are kept.
    """
    rows, columns = vertices_m.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (corner.ravel() for corner in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    if cells is not None:
        a, b, c, d = (corner[cells.ravel()] for corner in (a, b, c, d))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return Mesh(vertices_m.reshape(-1, 3), triangles, None if road_m is None else road_m.reshape(-1, 3))


def extruded(profile_yz_m: FloatArray, xs_m: FloatArray) -> Mesh:
    """Open (P, 2) profile of (y, z) drawn along x through the positions `xs_m`."""
    lattice = np.empty((len(xs_m), len(profile_yz_m), 3))
    lattice[..., 0] = xs_m[:, None]
    lattice[..., 1:] = profile_yz_m
    return grid(lattice)


def box(length_m: float, width_m: float, height_m: float) -> Mesh:
    """Box about the z axis, standing on z = 0."""
    corners = np.array([[x, y, z] for z in (0, 1) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    hull = ConvexHull(corners)
    return Mesh(corners * np.array([length_m, width_m, height_m]), hull.simplices.astype(np.int64))


def cylinder(radius_m: float, height_m: float, top_radius_m: float | None = None, sides: int = 20) -> Mesh:
    """Closed cylinder or cone frustum about the z axis, standing on z = 0."""
    angles = np.linspace(0, 2 * np.pi, sides + 1)
    top = radius_m if top_radius_m is None else top_radius_m
    rings = [(0.0, 0.0), (radius_m, 0.0), (top, height_m), (0.0, height_m)]
    lattice = np.array([[[r * np.cos(a), r * np.sin(a), z] for a in angles] for r, z in rings])
    return grid(lattice)
