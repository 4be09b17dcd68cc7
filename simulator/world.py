"""The simulator, read from one file: a street becomes meshes, rays are cast into them, and hits become measurements.

street = first_light_street(seed)
world = World(street)
sweep = world.sweep(LidarModel(), Standing(street_from_sensor), 0.0, rng)
image = world.render(CameraModel(), street_from_vehicle)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.motion import Motion
from simulator.painting.paint import Painter
from simulator.painting.sky import AFTERNOON, Daylight
from simulator.rays import NO_GEOMETRY, RayScene
from simulator.readings import Sweep
from simulator.scene.furnish import furnish
from simulator.scene.mover import Mover, MovingScene, NearerHits, Rays
from simulator.scene.scenery import Part, Surface
from simulator.scene.terrain import Terrain
from simulator.sensors.camera import CameraModel, Shot, expose, surfaces_seen
from simulator.sensors.lidar import LidarModel, measure
from simulator.streets.road_classes import RoadClasses
from simulator.streets.street import Street

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

    def replace(self, nearer: NearerHits, mover: int) -> None:
        """Put the hits on one mover in the place of those behind it."""
        index = nearer.index
        self.distance[index], self.part[index], self.normal[index] = nearer.distance, nearer.part, nearer.normal
        self.triangle[index], self.uv[index], self.mover[index] = nearer.triangle, nearer.uv, mover


class World:
    """A street and what moves through it, to be looked at.

    Movers' parts come after the street's own in `parts`, each in its mover's frame.
    """

    def __init__(self, street: Street, movers: Sequence[Mover] = (), daylight: Daylight = AFTERNOON) -> None:
        self.street, self.daylight = street, daylight
        self.terrain = Terrain(street)
        carriageways = [
            Part(Surface.ROAD, self.terrain.mesh(road), road=index) for index, road in enumerate(street.roads)
        ]
        still = [*carriageways, *furnish(self.terrain)]
        self.parts = [*still, *(part for mover in movers for part in mover.model.parts)]
        self._scene = RayScene([part.mesh.moved(part.street_from_part) for part in still])
        self._still = np.array([part.street_from_part for part in still])
        self._moving = _moving_scenes(movers, len(still))
        self._road_corners = _RoadCorners(still)
        self._road_of_part = np.array([part.road for part in still])
        self._road_classes = RoadClasses(street)
        self._surface_of_part = np.array([part.surface for part in self.parts] + [Surface.NOTHING], dtype=np.uint8)
        self._obstacle_of_part = np.array([part.obstacle_id for part in self.parts] + [0], dtype=np.int32)
        self._painter = Painter(street, self.parts, daylight)

    def cast(
        self,
        origins_m: Float32Array,
        directions: Float32Array,
        time_s: FloatArray | float = 0.0,
        ignored_mover: int = 0,
        reach_m: float = math.inf,
    ) -> Hits:
        """First hits of rays from (N, 3) or (3,) origins along unit (N, 3) directions, frame `street`.

        Each ray is sent at its own time (N,), or all at one. Movers beyond `reach_m` may be missed.
        """
        answer = self._scene.cast(origins_m, directions)
        part = answer.geometry.astype(np.int32)
        part[answer.geometry == NO_GEOMETRY] = -1
        mover = np.zeros(len(part), dtype=np.int32)
        hits = Hits(answer.distance, part, answer.normal, mover, answer.triangle, answer.uv)
        others = [moving for moving in self._moving if moving.mover.number != ignored_mover]
        if others:
            rays = Rays(origins_m, directions, np.atleast_1d(np.asarray(time_s, dtype=np.float64)), reach_m)
            for moving in others:
                nearer = moving.cast(rays, hits.distance)
                if nearer is not None:
                    hits.replace(nearer, moving.mover.number)
        return hits

    def reaches(
        self, points_m: Float32Array, direction: Float32Array, time_s: float = 0.0, ignored_mover: int = 0
    ) -> NDArray[np.bool_]:
        """Whether the way from each point (N, 3) along one unit direction is free."""
        free = ~self._scene.blocked(points_m, np.broadcast_to(direction, points_m.shape))
        for moving in self._moving:
            if moving.mover.number != ignored_mover:
                free[moving.hides(points_m, direction, time_s)] = False
        return free

    def part_from_street(self, time_s: float) -> Float32Array:
        """Frames of all parts (P, 4, 4) at a time."""
        moved = [
            moving.pose(time_s) @ part.street_from_part for moving in self._moving for part in moving.mover.model.parts
        ]
        return np.linalg.inv(np.concatenate([self._still, *(pose[None] for pose in moved)])).astype(np.float32)

    def surfaces(self, hits: Hits) -> NDArray[np.uint8]:
        """`Surface` of each hit."""
        return self._surface_of_part[hits.part]

    def classes(self, hits: Hits, points_m: Float32Array) -> NDArray[np.uint8]:
        """`Surface` of each hit at its point (N, 3); a carriageway is told apart into road, paint, iron and water."""
        surface = self.surfaces(hits).copy()
        on_road = np.flatnonzero(surface == Surface.ROAD)
        part = hits.part[on_road]
        road_m = self._road_corners.at(part, hits.triangle[on_road], hits.uv[on_road])
        surface[on_road] = self._road_classes.of(self._road_of_part[part], road_m, points_m[on_road])
        return surface

    def road_positions(self, hits: Hits) -> Float32Array:
        """Distance s, offset t and height above the edge (N, 3) of hits on what is drawn along a road, else 0."""
        return self._road_corners.at(hits.part, hits.triangle, hits.uv)

    def obstacle_ids(self, hits: Hits, points_m: FloatArray) -> NDArray[np.int32]:
        """Number of the obstacle that each hit lies on, 0 for none: things by mesh, reliefs by footprint."""
        ids = self._obstacle_of_part[hits.part]
        on_road = np.flatnonzero(self.surfaces(hits) == Surface.ROAD)
        x, y = points_m[on_road, 0], points_m[on_road, 1]
        order = np.argsort(x)
        for placed, relief in self.terrain.reliefs:
            first, last = np.searchsorted(x, [placed.x_m - relief.reach_m, placed.x_m + relief.reach_m], sorter=order)
            beside = order[first:last]
            near = beside[np.abs(y[beside] - placed.y_m) <= relief.reach_m]
            ids[on_road[near[placed.covers(x[near], y[near])]]] = placed.obstacle_id
        return ids

    def sweep(
        self, lidar: LidarModel, motion: Motion, end_s: float, rng: np.random.Generator, ignored_mover: int = 0
    ) -> Sweep:
        """The turn of a moving LiDAR that ends at `end_s`; it does not see the vehicle that carries it."""
        return measure(self, lidar, motion, end_s, rng, ignored_mover)

    def render(
        self,
        camera: CameraModel,
        street_from_vehicle: FloatArray,
        supersample: int = 1,
        time_s: float = 0.0,
        ignored_mover: int = 0,
    ) -> NDArray[np.uint8]:
        """Picture (H, W, 3) uint8 BGR; pixels on edges are the mean of `supersample` x `supersample` rays."""
        shot = Shot(street_from_vehicle @ camera.vehicle_from_camera, time_s, ignored_mover)
        return expose(self, self._painter, camera, shot, supersample)

    def segment(
        self, camera: CameraModel, street_from_vehicle: FloatArray, time_s: float = 0.0, ignored_mover: int = 0
    ) -> NDArray[np.uint8]:
        """What each pixel's middle shows: (H, W) `Surface` values, `NOTHING` for the sky."""
        return surfaces_seen(
            self, camera, Shot(street_from_vehicle @ camera.vehicle_from_camera, time_s, ignored_mover)
        )


class _RoadCorners:
    """Road positions of the corners of every triangle that has them, to interpolate between."""

    def __init__(self, parts: list[Part]) -> None:
        corners = [np.zeros((1, 3, 3), np.float32)]
        self._first = np.full(len(parts), -1)
        count = 1
        for index, part in enumerate(parts):
            if part.mesh.road_m is not None:
                self._first[index] = count
                corners.append(part.mesh.road_m[part.mesh.triangles].astype(np.float32))
                count += len(part.mesh.triangles)
        self._corners = np.concatenate(corners)

    def at(self, part: NDArray[np.int32], triangle: NDArray[np.uint32], uv: Float32Array) -> Float32Array:
        still = np.where(part < len(self._first), part, -1)
        first = np.where(still < 0, -1, self._first[still])
        corners = self._corners[np.where(first < 0, 0, first + triangle.astype(np.int64))]
        u, v = uv.T[..., None]
        return np.asarray(corners[:, 0] * (1 - u - v) + corners[:, 1] * u + corners[:, 2] * v)


def _moving_scenes(movers: Sequence[Mover], first_part: int) -> list[MovingScene]:
    """Movers of the same model share its scene."""
    scenes: dict[int, RayScene] = {}
    moving = []
    for mover in movers:
        parts = mover.model.parts
        if id(mover.model) not in scenes:
            scenes[id(mover.model)] = RayScene([part.mesh.moved(part.street_from_part) for part in parts])
        moving.append(MovingScene(mover, scenes[id(mover.model)], first_part))
        first_part += len(parts)
    return moving
