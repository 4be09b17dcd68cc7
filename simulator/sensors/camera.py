"""A pinhole camera: rays through pixels, sunlight with shadows, sky light and haze, and the exposed picture."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulator.painting.paint import Painter
from simulator.painting.view import View

if TYPE_CHECKING:
    from simulator.world import World

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]

HAZE_LENGTH_M = 1_400.0
"""A clear day near the sea: distant hills fade, the street does not."""

RAYS_AT_ONCE = 40_000
"""So many rays' intermediate arrays stay within a processor's cache of some megabytes (measured)."""

EDGE_CONTRAST = 28
"""Steps of 8 bits between neighbours above which a pixel is refined: asphalt's grain stays below."""

SHADOW_OFFSET_M = 0.004
"""Shadow rays start this far off the surface: float32 resolves 0.03 mm at the street's far end."""


def forward_camera(x_m: float, z_m: float, pitch_down_rad: float) -> FloatArray:
    """`vehicle_from_camera` (4, 4) of a camera on the car's middle line that looks ahead, tilted down."""
    sin, cos = math.sin(pitch_down_rad), math.cos(pitch_down_rad)
    right, down, forward = (0.0, -1.0, 0.0), (-sin, 0.0, -cos), (cos, 0.0, -sin)
    transform = np.eye(4)
    transform[:3, :3] = np.array([right, down, forward]).T
    transform[:3, 3] = (x_m, 0.0, z_m)
    return transform


@dataclass(frozen=True, slots=True)
class CameraModel:
    """Pinhole with square pixels and the principal point in the middle; by default behind the windshield."""

    width_px: int = 1280
    height_px: int = 720
    horizontal_fov_rad: float = math.radians(65.0)
    vehicle_from_camera: FloatArray = field(default_factory=lambda: forward_camera(0.6, 1.6, math.radians(4.0)))

    @property
    def focal_px(self) -> float:
        """Focal length in pixels."""
        return self.width_px / 2 / math.tan(self.horizontal_fov_rad / 2)

    @property
    def matrix(self) -> FloatArray:
        """(3, 3) matrix K; the middle of the first pixel is at (0.5, 0.5)."""
        return np.array(
            [[self.focal_px, 0, self.width_px / 2], [0, self.focal_px, self.height_px / 2], [0.0, 0.0, 1.0]]
        )


@dataclass(frozen=True, slots=True)
class Shot:
    """From where, `street_from_camera` (4, 4), and when a picture is taken, and the vehicle that carries the camera."""

    street_from_camera: FloatArray
    time_s: float = 0.0
    ignored_mover: int = 0


def expose(world: World, painter: Painter, camera: CameraModel, shot: Shot, supersample: int) -> NDArray[np.uint8]:
    """Picture (H, W, 3) uint8 BGR: a ray through each pixel's middle, `supersample` squared where neighbours differ."""
    width, height = camera.width_px, camera.height_px
    v, u = np.divmod(np.arange(width * height), width)
    light = _mean_light(world, painter, camera, shot, np.stack([u, v], axis=1), 1)
    if supersample > 1:
        edges = np.flatnonzero(_edges(_developed(light.reshape(height, width, 3))))
        light[edges] = _mean_light(world, painter, camera, shot, np.stack([u[edges], v[edges]], axis=1), supersample)
    return _developed(light.reshape(height, width, 3))


def _mean_light(
    world: World, painter: Painter, camera: CameraModel, shot: Shot, pixels: NDArray[np.intp], rays_a_side: int
) -> Float32Array:
    """Linear RGB (N, 3) of pixels (N, 2), each the mean of a square of rays; so many at once as a cache holds."""
    light = np.empty((len(pixels), 3), dtype=np.float32)
    at_once = max(1, RAYS_AT_ONCE // rays_a_side**2)
    for first in range(0, len(pixels), at_once):
        some = pixels[first : first + at_once]
        rays = _rays(camera, shot, some, rays_a_side)
        seen = _radiance(world, painter, shot, rays, 1 / rays_a_side / camera.focal_px)
        light[first : first + at_once] = seen.reshape(len(some), rays_a_side**2, 3).mean(axis=1)
    return light


def _edges(picture: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Pixels (H, W) that differ from a neighbour so that a staircase would be seen."""
    values = picture.astype(np.int16)
    edges = np.zeros(picture.shape[:2], dtype=bool)
    beside = (np.abs(np.diff(values, axis=1)) > EDGE_CONTRAST).any(axis=2)
    below = (np.abs(np.diff(values, axis=0)) > EDGE_CONTRAST).any(axis=2)
    edges[:, :-1] |= beside
    edges[:, 1:] |= beside
    edges[:-1] |= below
    edges[1:] |= below
    return edges


def surfaces_seen(world: World, camera: CameraModel, shot: Shot) -> NDArray[np.uint8]:
    """`Surface` values (H, W) under the middles of the pixels."""
    v, u = np.divmod(np.arange(camera.width_px * camera.height_px), camera.width_px)
    rays = _rays(camera, shot, np.stack([u, v], axis=1), 1)
    origin_m = shot.street_from_camera[:3, 3].astype(np.float32)
    hits = world.cast(origin_m, rays, shot.time_s, shot.ignored_mover)
    points = origin_m + rays * np.where(hits.part >= 0, hits.distance, np.float32(0))[:, None]
    return world.classes(hits, points).reshape(camera.height_px, camera.width_px)


def _rays(camera: CameraModel, shot: Shot, pixels: NDArray[np.intp], rays_a_side: int) -> Float32Array:
    """Unit directions (N * rays_a_side^2, 3), frame `street`, through pixels (N, 2) of column and row."""
    within = (np.arange(rays_a_side) + 0.5) / rays_a_side
    offsets = np.stack([axis.ravel() for axis in np.meshgrid(within, within)], axis=1)
    middle = np.array([camera.width_px / 2, camera.height_px / 2])
    plane = ((pixels[:, None] + offsets - middle) / camera.focal_px).reshape(-1, 2)
    rays = np.concatenate([plane, np.ones((len(plane), 1))], axis=1, dtype=np.float32)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return np.asarray(rays @ shot.street_from_camera[:3, :3].T.astype(np.float32))


def _radiance(world: World, painter: Painter, shot: Shot, rays: Float32Array, pixel_rad: float) -> Float32Array:
    """Linear RGB (N, 3) that arrives along unit rays (N, 3)."""
    daylight, origin_m = world.daylight, shot.street_from_camera[:3, 3].astype(np.float32)
    hits = world.cast(origin_m, rays, shot.time_s, shot.ignored_mover)
    colours = np.empty_like(rays)
    seen = hits.part >= 0
    colours[~seen] = daylight.sky_colour(rays[~seen])
    ray, distance = rays[seen], hits.distance[seen]
    facing = np.einsum("ij,ij->i", hits.normal[seen], ray)
    view = View(
        point_m=origin_m + ray * distance[:, None],
        road_m=world.road_positions(hits)[seen],
        normal=hits.normal[seen] * np.where(facing > 0, np.float32(-1), np.float32(1))[:, None],
        ray=ray,
        part=hits.part[seen],
        surface=world.surfaces(hits)[seen],
        pixel_m=distance * np.float32(pixel_rad),
        cosine=np.maximum(np.abs(facing), np.float32(0.04)),
        part_from_street=world.part_from_street(shot.time_s),
    )
    paint = painter.paint(view)
    lit = _lit(world, shot, view)
    # Sky light comes from above, light that the ground throws back from below.
    ambient = (0.62 + 0.38 * view.normal[:, 2]) * paint.openness
    colour = paint.albedo * (lit[:, None] * daylight.sun_light + ambient[:, None] * daylight.sky_light) + paint.glow
    clear = np.exp(distance * np.float32(-1 / HAZE_LENGTH_M))[:, None]
    colours[seen] = colour * clear + daylight.haze * (1 - clear)
    return colours


def _lit(world: World, shot: Shot, view: View) -> Float32Array:
    """Cosine of the sun's angle to each surface, 0 in shadow (Lambert)."""
    sun = world.daylight.sun_direction
    cosine = np.maximum(view.normal @ sun, np.float32(0))
    towards = np.flatnonzero(cosine > 0)
    start = view.point_m[towards] + view.normal[towards] * np.float32(SHADOW_OFFSET_M)
    cosine[towards] *= world.reaches(start, sun, shot.time_s, shot.ignored_mover)
    return np.asarray(cosine)


def _developed(light: Float32Array) -> NDArray[np.uint8]:
    """Film-like curve (Narkowicz 2015, a fit of ACES), gamma, 8 bits, BGR."""
    curve = np.clip(light * (2.51 * light + 0.03) / (light * (2.43 * light + 0.59) + 0.14), 0, 1)
    return np.ascontiguousarray(np.rint(255 * curve ** np.float32(1 / 2.2)).astype(np.uint8)[..., ::-1])
