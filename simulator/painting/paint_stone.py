"""Kerbs, paving slabs, the brick wall, grass, roofs and the other surfaces beside the road."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.painting.texture import Texture, fractal_noise
from simulator.painting.view import Paint, View, blend, cell_value, repeated, rgb, stripe
from simulator.scene.roadside import WALL_HEIGHT_M

Float32Array = NDArray[np.float32]

CONCRETE, MORTAR, BRICK, COPING = (
    rgb(0.36, 0.35, 0.32),
    rgb(0.34, 0.31, 0.27),
    rgb(0.33, 0.145, 0.085),
    rgb(0.42, 0.40, 0.36),
)
SLAB, GRASS, DRY_GRASS = rgb(0.30, 0.285, 0.26), rgb(0.060, 0.085, 0.028), rgb(0.15, 0.135, 0.07)

SLAB_M, KERB_STONE_M = 0.5, 1.0
BRICK_LENGTH_M, BRICK_HEIGHT_M, JOINT_HALF_M = 0.25, 0.083, 0.006
TILE_ROW_M = 0.33


class StonePaint:
    """Paint of everything mineral or green beside the road."""

    def __init__(self, seed: int) -> None:
        self._fine = Texture(fractal_noise(seed + 11, 1024, slope=0.3), 0.008)
        self._coarse = Texture(fractal_noise(seed + 12, 1024, slope=0.9), 0.06)

    def kerb(self, view: View) -> Paint:
        """Concrete stones, one metre each, dirty near the gutter."""
        x, y, z = view.road_m.T
        joint = stripe(repeated(x, KERB_STONE_M), 0.006, view.pixel_m / view.cosine)
        tone = 1 + self._noise(x, y + z, view) + 0.12 * (cell_value(np.floor(x), np.sign(y)) - 0.5)
        dirt = np.clip((0.10 - z) / 0.10, 0, 1) * 0.45
        return Paint.matt(CONCRETE * (tone * (1 - 0.6 * joint) * (1 - dirt))[:, None], 1 - 0.6 * dirt)

    def pavement(self, view: View) -> Paint:
        """Square slabs in running bond, each with its own shade."""
        x, y, _ = view.road_m.T
        row = np.floor(y / SLAB_M)
        shifted = x + row * np.float32(SLAB_M / 2)
        along = view.pixel_m / view.cosine
        joint = np.maximum(
            stripe(repeated(y, SLAB_M), 0.006, view.pixel_m), stripe(repeated(shifted, SLAB_M), 0.006, along)
        )
        shade = (0.22 * cell_value(row, np.floor(shifted / SLAB_M)) - 0.11) * np.clip(0.35 / along, 0, 1)
        tone = (1 + shade + self._noise(x, y, view)) * (1 - 0.55 * joint)
        foot = np.clip((np.abs(y) - 5.1) / 0.4, 0, 1) * 0.35
        return Paint.matt(SLAB * tone[:, None], 1 - foot)

    def wall(self, view: View) -> Paint:
        """Bricks in running bond below a concrete coping, damp at the foot."""
        x, _y, z = view.road_m.T
        row = np.floor(z / BRICK_HEIGHT_M)
        shifted = x + row * np.float32(BRICK_LENGTH_M / 2)
        along = view.pixel_m / view.cosine
        joint = np.maximum(
            stripe(repeated(z, BRICK_HEIGHT_M), JOINT_HALF_M, view.pixel_m),
            stripe(repeated(shifted, BRICK_LENGTH_M), JOINT_HALF_M, along),
        )
        shade = (0.5 * cell_value(row, np.floor(shifted / BRICK_LENGTH_M)) - 0.25) * np.clip(0.10 / along, 0, 1)
        noise = self._noise(x, z, view)
        colour = blend(BRICK * np.maximum(1 + shade + noise, 0.3)[:, None], MORTAR, joint)
        coping = z > WALL_HEIGHT_M - 0.002
        seams = 1 - 0.5 * stripe(repeated(x, 0.9), 0.006, along)
        colour = np.where(coping[:, None], COPING * ((1 + noise) * seams)[:, None], colour)
        damp = np.clip(0.55 - z * 1.6, 0, 0.4)
        return Paint.matt(colour * (1 - damp)[:, None], 0.75 - 0.5 * damp)

    def ground(self, view: View) -> Paint:
        """Grass with dry patches."""
        x, y, _ = view.point_m.T
        dry = np.clip(0.35 + 0.35 * self._coarse.smooth(x * 0.3, y * 0.3), 0, 1)
        tone = np.maximum(1 + 2.2 * self._noise(x, y, view), 0.3)
        return Paint.matt(blend(GRASS, DRY_GRASS, dry) * tone[:, None], 0.9)

    def roof(self, view: View, local_m: Float32Array, colour: Float32Array) -> Paint:
        """Rows of clay tiles."""
        row = np.floor(local_m[:, 1] / TILE_ROW_M)
        tile = np.floor(local_m[:, 0] / 0.22)
        fade = np.clip(0.15 / view.pixel_m, 0, 1)
        edge = stripe(repeated(local_m[:, 1], TILE_ROW_M), 0.02, view.pixel_m / view.cosine)
        shade = 1 + (0.4 * cell_value(row, tile) - 0.2) * fade + 0.10 * self._coarse.smooth(*local_m[:, :2].T)
        return Paint.matt(colour * (shade * (1 - 0.45 * edge))[:, None], 0.9)

    def leaves(self, view: View, local_m: Float32Array, colour: Float32Array) -> Paint:
        """Foliage: light and dark tufts, darker inside and below."""
        x, y, z = view.point_m.T
        tufts = self._coarse.smooth(x + 0.7 * z, y + 0.9 * z)
        tone = np.clip(1 + 0.30 * tufts, 0.3, 2.0)
        below = np.clip((local_m[:, 2] - 2.4) / 3.0, 0.25, 1)
        return Paint.matt(colour * (tone * below)[:, None], 0.75 * below)

    def wood(self, view: View, local_m: Float32Array, colour: Float32Array) -> Paint:
        """Weathered boards with a grain along their length."""
        x, y, z = local_m.T
        fibre = self._fine.at(x * 0.35 + z, (y + z) * 1.5) * np.clip(0.012 / view.pixel_m, 0, 1)
        board = cell_value(np.floor(x * 7.5), np.floor(y * 4.0))
        return Paint.matt(colour * np.maximum(0.85 + 0.35 * board + 0.22 * fibre, 0.2)[:, None], 0.85)

    def plain(self, view: View, colour: Float32Array) -> Paint:
        """One colour, slightly mottled."""
        x, y, z = view.point_m.T
        return Paint.matt(colour * (1 + self._noise(x + y, z, view))[:, None])

    def plaster(self, local_m: Float32Array, pixel_m: Float32Array) -> Float32Array:
        """Brightness (N,) of plaster: streaks and stains."""
        x, y, z = local_m.T
        streaks = self._coarse.smooth((x + y) * 1.3, z * 0.18)
        return np.asarray(1 + 0.07 * streaks + 0.05 * self._coarse.smooth(x + y, z) * np.clip(0.2 / pixel_m, 0, 1))

    def _noise(self, u_m: Float32Array, v_m: Float32Array, view: View) -> Float32Array:
        fine = self._fine.at(u_m, v_m) * np.clip(0.012 / view.pixel_m, 0, 1)
        return np.asarray(0.08 * fine + 0.07 * self._coarse.smooth(u_m, v_m))
