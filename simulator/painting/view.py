"""What the camera sees of a surface, and what the surface answers: the values between `camera` and `paint`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float32Array = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class View:
    """N hits as the camera sees them, frame `street`.

    `point_m`, unit `normal` towards the camera, unit `ray` (all (N, 3)); `part` and `surface` (N,); `pixel_m` is the
    width of a pixel there across the ray, `cosine` that of the angle between ray and normal. `road_m` (N, 3) is the
    distance along a road, the offset from it and the height above its edge, where the surface is drawn along one.
    `part_from_street` (P, 4, 4) are the frames of all parts at the time.
    """

    point_m: Float32Array
    road_m: Float32Array
    normal: Float32Array
    ray: Float32Array
    part: NDArray[np.int32]
    surface: NDArray[np.uint8]
    pixel_m: Float32Array
    cosine: Float32Array
    part_from_street: Float32Array

    def local(self) -> tuple[Float32Array, Float32Array]:
        """Points and normals (N, 3) in the frames of their parts."""
        points, normals = np.empty_like(self.point_m), np.empty_like(self.normal)
        for part in np.unique(self.part):
            chosen, transform = self.part == part, self.part_from_street[part]
            points[chosen] = self.point_m[chosen] @ transform[:3, :3].T + transform[:3, 3]
            normals[chosen] = self.normal[chosen] @ transform[:3, :3].T
        return points, normals

    def only(self, chosen: NDArray[np.intp]) -> View:
        """Some of the hits."""
        return View(
            self.point_m[chosen],
            self.road_m[chosen],
            self.normal[chosen],
            self.ray[chosen],
            self.part[chosen],
            self.surface[chosen],
            self.pixel_m[chosen],
            self.cosine[chosen],
            self.part_from_street,
        )


@dataclass(frozen=True, slots=True)
class Paint:
    """Reflected share of light (N, 3), light of its own or mirrored (N, 3), and share of the sky that is seen (N,)."""

    albedo: Float32Array
    glow: Float32Array
    openness: Float32Array

    @classmethod
    def matt(cls, albedo: Float32Array, openness: Float32Array | float = 1.0) -> Paint:
        """A surface that mirrors nothing."""
        seen = np.broadcast_to(np.asarray(openness, dtype=np.float32), albedo.shape[:1])
        return cls(np.asarray(albedo, dtype=np.float32), np.zeros_like(albedo, dtype=np.float32), seen)


def rgb(red: float, green: float, blue: float) -> Float32Array:
    """A colour in linear RGB."""
    return np.array([red, green, blue], dtype=np.float32)


def blend(low: Float32Array, high: Float32Array, share: Float32Array) -> Float32Array:
    """`low` (N, 3) or (3,) towards `high` by `share` (N,)."""
    return np.asarray(low + (high - low) * share[:, None], dtype=np.float32)


def step(value: Float32Array, edge: float, width: Float32Array) -> Float32Array:
    """0 below an edge, 1 above, over a ramp one pixel wide: an anti-aliased comparison."""
    return np.asarray(np.clip((value - np.float32(edge)) / width + np.float32(0.5), 0, 1))


def stripe(value: Float32Array, half_width: float, pixel: Float32Array) -> Float32Array:
    """Share of a pixel within `half_width` of 0: keeps its brightness when thinner than the pixel."""
    width = np.maximum(pixel, np.float32(1e-4))
    covered = np.minimum(value + width / 2, half_width) - np.maximum(value - width / 2, -half_width)
    return np.asarray(np.clip(covered / width, 0, 1))


def repeated(value: Float32Array, period: float) -> Float32Array:
    """Signed distance to the nearest multiple of a period."""
    return np.asarray(value - np.float32(period) * np.rint(value / np.float32(period)))


def cell_value(row: Float32Array, column: Float32Array) -> Float32Array:
    """Pseudo-random number in [0, 1) of a lattice cell, the same each time."""
    mixed = row.astype(np.int64) * 73_856_093 ^ column.astype(np.int64) * 19_349_663
    return np.asarray((mixed * 2_654_435_761 >> 7 & 0xFFFF).astype(np.float32) / np.float32(65_536))
