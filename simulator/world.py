"""The simulator, read from one file: a street becomes meshes, rays are cast into them, and hits become measurements.

street = first_light_street(seed)
world = World(street)
sweep = world.sweep(LidarModel(), Standing(street_from_sensor), 0.0, rng)
image = world.render(CameraModel(), street_from_vehicle)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from simulator.camera import CameraModel, expose
from simulator.furnish import furnish
from simulator.lidar import LidarModel, measure
from simulator.motion import Motion
from simulator.paint import Painter
from simulator.readings import Sweep
from simulator.scenery import Part, Surface
from simulator.street import Street
from simulator.terrain import Terrain

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Hits:
    """Where N rays ended: distance in units of the ray's direction (inf: nowhere), part index (-1), unit normal.

    `mover` is the number of the moving thing that was hit, 0 for what stands still; `triangle` and `uv` (N, 2) say
    where in the part: at (1 - u - v) a + u b + v c.
    """

    distance: Float32Array
    part: NDArray[np.int32]
    normal: Float32Array
    mover: NDArray[np.int32]
    triangle: NDArray[np.uint32]
    uv: Float32Array


class World:
    """A street that can be looked at."""

    def __init__(self, street: Street) -> None:
        self.street = street
        self.terrain = Terrain(street)
        carriageways = [
            Part(Surface.ROAD, self.terrain.mesh(road), road=index) for index, road in enumerate(street.roads)
        ]
        self.parts = [*carriageways, *furnish(self.terrain)]
        self._road_corners = _RoadCorners(self.parts)
        self._surface_of_part = np.array([part.surface for part in self.parts] + [Surface.NOTHING], dtype=np.uint8)
        self._obstacle_of_part = np.array([part.obstacle_id for part in self.parts] + [0], dtype=np.int32)
        self._scene = o3d.t.geometry.RaycastingScene()
        for part in self.parts:
            _add(self._scene, part)
        self._painter = Painter(street, self.parts)

    def cast(
        self,
        origins_m: Float32Array,
        directions: Float32Array,
        time_s: FloatArray | float = 0.0,
        ignored_mover: int = 0,
    ) -> Hits:
        """First hits of rays from (N, 3) or (3,) origins along (N, 3) directions, frame `street`, each at its time."""
        rays = np.concatenate([np.broadcast_to(origins_m, directions.shape), directions], axis=1, dtype=np.float32)
        answer = self._scene.cast_rays(_tensor(rays))
        part = answer["geometry_ids"].numpy().astype(np.int32)
        part[part >= len(self.parts)] = -1
        mover = np.zeros(len(part), dtype=np.int32)
        return Hits(
            distance=answer["t_hit"].numpy(),
            part=part,
            normal=answer["primitive_normals"].numpy(),
            mover=mover,
            triangle=answer["primitive_ids"].numpy(),
            uv=answer["primitive_uvs"].numpy(),
        )

    def reaches(self, points_m: Float32Array, direction: Float32Array) -> NDArray[np.bool_]:
        """Whether the way from each point (N, 3) along one direction is free."""
        rays = np.concatenate([points_m, np.broadcast_to(direction, points_m.shape)], axis=1, dtype=np.float32)
        return np.asarray(~self._scene.test_occlusions(_tensor(rays)).numpy())

    def surfaces(self, hits: Hits) -> NDArray[np.uint8]:
        """`Surface` of each hit."""
        return self._surface_of_part[hits.part]

    def road_positions(self, hits: Hits) -> Float32Array:
        """Distance s, offset t and height above the edge (N, 3) of hits on what is drawn along a road, else 0."""
        return self._road_corners.at(hits)

    def obstacle_ids(self, hits: Hits, points_m: FloatArray) -> NDArray[np.int32]:
        """Number of the obstacle that each hit lies on, 0 for none: things by mesh, reliefs by footprint."""
        ids = self._obstacle_of_part[hits.part]
        on_road = np.flatnonzero(self.surfaces(hits) == Surface.ROAD)
        for placed, relief in self.terrain.reliefs:
            x, y = points_m[on_road, 0], points_m[on_road, 1]
            near = np.hypot(x - placed.x_m, y - placed.y_m) <= relief.reach_m
            inside = placed.covers(x[near], y[near])
            ids[on_road[near][inside]] = placed.obstacle_id
        return ids

    def sweep(
        self, lidar: LidarModel, motion: Motion, end_s: float, rng: np.random.Generator, ignored_mover: int = 0
    ) -> Sweep:
        """The turn of a moving LiDAR that ends at `end_s`; it does not see the vehicle that carries it."""
        return measure(self, lidar, motion, end_s, rng, ignored_mover)

    def render(self, camera: CameraModel, street_from_vehicle: FloatArray, supersample: int = 1) -> NDArray[np.uint8]:
        """Picture (H, W, 3) uint8 BGR; each pixel is the mean of `supersample` x `supersample` rays."""
        return expose(self, self._painter, camera, street_from_vehicle @ camera.vehicle_from_camera, supersample)


class _RoadCorners:
    """Road positions of the corners of every triangle that has them, to interpolate between."""

    def __init__(self, parts: list[Part]) -> None:
        corners = [np.zeros((1, 3, 3), np.float32)]
        self._first = np.full(len(parts) + 1, -1)
        count = 1
        for index, part in enumerate(parts):
            if part.mesh.road_m is not None:
                self._first[index] = count
                corners.append(part.mesh.road_m[part.mesh.triangles].astype(np.float32))
                count += len(part.mesh.triangles)
        self._corners = np.concatenate(corners)

    def at(self, hits: Hits) -> Float32Array:
        first = self._first[hits.part]
        corners = self._corners[np.where(first < 0, 0, first + hits.triangle.astype(np.int64))]
        u, v = hits.uv.T[..., None]
        return np.asarray(corners[:, 0] * (1 - u - v) + corners[:, 1] * u + corners[:, 2] * v)


def _add(scene: o3d.t.geometry.RaycastingScene, part: Part) -> None:
    mesh = part.mesh.moved(part.street_from_part)
    scene.add_triangles(_tensor(mesh.vertices_m.astype(np.float32)), _tensor(mesh.triangles.astype(np.uint32)))


def _tensor(array: Any) -> o3d.core.Tensor:  # Open3D's stubs know no typed arrays
    tensor: o3d.core.Tensor = o3d.core.Tensor.from_numpy(array)
    return tensor
