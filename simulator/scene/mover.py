"""What moves through the street: rigid models, each seen by moving the rays into its own frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulator.motion import Motion
from simulator.rays import RayScene
from simulator.scene.scenery import Part

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]

SEEN_WITHIN_M = 250.0
"""Farther off, a car fills less than the pixel of a picture or the gap between two beams."""


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """Parts in the mover's frame (x forward, on the ground), within `radius_m` of a point `middle_m` above it."""

    parts: tuple[Part, ...]
    middle_m: float
    radius_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Mover:
    """A model on its way; `number` is 1 or more and its own."""

    number: int
    model: Model
    motion: Motion


class Rays:
    """Rays from (N, 3) or (3,) origins along unit (N, 3) directions, each at its time (N,), or all at one (1,).

    What begins farther than `reach_m` from the first origin is not looked for.
    """

    def __init__(self, origins_m: Float32Array, directions: Float32Array, time_s: FloatArray, reach_m: float) -> None:
        self.origins_m = np.broadcast_to(origins_m, directions.shape)
        self.directions, self.time_s = directions, time_s
        self.reach_m = min(reach_m, SEEN_WITHIN_M)
        self.span_s = (float(time_s.min()), float(time_s.max()))


@dataclass(slots=True)
class NearerHits:
    """Hits of some rays, by their indices, on one mover, in the order of the rays; normals in the frame `street`."""

    index: NDArray[np.intp]
    distance: Float32Array
    part: NDArray[np.int32]
    normal: Float32Array
    triangle: NDArray[np.uint32]
    uv: Float32Array


class MovingScene:
    """One mover, its parts numbered from `first_part`."""

    def __init__(self, mover: Mover, scene: RayScene, first_part: int) -> None:
        self.mover = mover
        self._scene, self._first_part = scene, first_part
        self._latest = ((math.nan, math.nan), np.empty((0, 4, 4)))

    def pose(self, time_s: float) -> FloatArray:
        """`street_from_mover` (4, 4)."""
        return np.asarray(self._ends((time_s, time_s))[0])

    def _ends(self, span_s: tuple[float, float]) -> FloatArray:
        """Poses (2, 4, 4) at the begin and the end of a span; the parts of a picture or a turn ask for the same."""
        if self._latest[0] != span_s:
            self._latest = (span_s, self.mover.motion.poses(np.array(span_s)))
        return self._latest[1]

    def cast(self, rays: Rays, before: Float32Array) -> NearerHits | None:
        """Hits nearer than `before` (N,), None where there are none."""
        index = self._towards(rays)
        if not index.size:
            return None
        mover_from_street = self._inverses(rays.time_s, index)
        starts = rays.origins_m[index]
        answer = self._scene.cast(*_moved(starts, rays.directions[index], mover_from_street))
        nearer = np.flatnonzero(answer.distance < before[index])
        if not nearer.size:
            return None
        turn = mover_from_street[:, :3, :3] if len(mover_from_street) == 1 else mover_from_street[nearer, :3, :3]
        return NearerHits(
            index=index[nearer],
            distance=answer.distance[nearer],
            part=answer.geometry[nearer].astype(np.int32) + self._first_part,
            # The transpose of mover_from_street turns back.
            normal=np.einsum("nji,nj->ni", np.broadcast_to(turn, (len(nearer), 3, 3)), answer.normal[nearer]),
            triangle=answer.triangle[nearer],
            uv=answer.uv[nearer],
        )

    def hides(self, points_m: Float32Array, direction: Float32Array, time_s: float) -> NDArray[np.intp]:
        """Indices of the points (N, 3) whose way along a unit direction this mover blocks."""
        pose = self.pose(time_s)
        middle = (pose[:3, 3] + self.mover.model.middle_m * pose[:3, 2]).astype(np.float32)
        rays = np.broadcast_to(direction, points_m.shape)
        index: NDArray[np.intp] = _towards_ball(points_m, rays, middle, np.float32(self.mover.model.radius_m))
        if not index.size:
            return index
        inverse = np.linalg.inv(pose)[None].astype(np.float32)
        start, rays = _moved(points_m[index], rays[index], inverse)
        return np.asarray(index[self._scene.blocked(start, rays)])

    def _towards(self, rays: Rays) -> NDArray[np.intp]:
        """Indices of the rays that may meet the mover's ball on its way."""
        ends = self._ends(rays.span_s)
        middles = ends[:, :3, 3] + self.mover.model.middle_m * ends[:, :3, 2]
        middle = middles.mean(axis=0)
        radius = self.mover.model.radius_m + float(np.linalg.norm(middles[1] - middles[0])) / 2
        if float(np.linalg.norm(middle - rays.origins_m[0])) - radius > rays.reach_m:
            return np.empty(0, dtype=np.intp)
        index: NDArray[np.intp] = _towards_ball(
            rays.origins_m, rays.directions, middle.astype(np.float32), np.float32(radius)
        )
        return index

    def _inverses(self, time_s: FloatArray, index: NDArray[np.intp]) -> Float32Array:
        """`mover_from_street` at the time of each ray (N, 4, 4), or one (1, 4, 4) for all."""
        if len(time_s) == 1:
            return np.linalg.inv(self.pose(time_s[0])[None]).astype(np.float32)
        times, which = np.unique(time_s[index], return_inverse=True)
        return np.asarray(np.linalg.inv(self.mover.motion.poses(times)).astype(np.float32)[which])


@njit(cache=True, nogil=True)
def _towards_ball(
    origins_m: Float32Array, directions: Float32Array, middle_m: Float32Array, radius_m: np.float32
) -> NDArray[np.intp]:
    """Indices of the rays (N, 3) with unit directions that pass a ball."""
    found = np.empty(len(directions), dtype=np.intp)
    count = 0
    for i in range(len(directions)):
        x, y, z = middle_m[0] - origins_m[i, 0], middle_m[1] - origins_m[i, 1], middle_m[2] - origins_m[i, 2]
        along = x * directions[i, 0] + y * directions[i, 1] + z * directions[i, 2]
        if along > -radius_m and x * x + y * y + z * z - along * along < radius_m * radius_m:
            found[count] = i
            count += 1
    return found[:count]


def _moved(
    origins_m: Float32Array, directions: Float32Array, a_from_b: Float32Array
) -> tuple[Float32Array, Float32Array]:
    """Rays of frame b in frame a, by one (1, 4, 4) transform or one each."""
    if len(a_from_b) == 1:
        turn, shift = a_from_b[0, :3, :3], a_from_b[0, :3, 3]
        return origins_m @ turn.T + shift, directions @ turn.T
    origins = np.einsum("nij,nj->ni", a_from_b[:, :3, :3], origins_m)
    return origins + a_from_b[:, :3, 3], np.einsum("nij,nj->ni", a_from_b[:, :3, :3], directions)
