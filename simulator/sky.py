"""Sun, sky and haze of a fine afternoon, in linear RGB."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from simulator.texture import Texture, fractal_noise

Float32Array = NDArray[np.float32]


def _unit(x: float, y: float, z: float) -> Float32Array:
    vector = np.array([x, y, z], dtype=np.float32)
    return np.asarray(vector / np.linalg.norm(vector))


SUN_DIRECTION = _unit(-0.30, -0.72, 0.80)
"""Towards the sun: behind the car on the right, so that holes show a shaded wall and a lit one."""

SUN_LIGHT = np.array([2.30, 2.06, 1.66], dtype=np.float32)
SKY_LIGHT = np.array([0.44, 0.50, 0.60], dtype=np.float32)
HAZE = np.array([0.50, 0.60, 0.72], dtype=np.float32)
ZENITH = np.array([0.06, 0.19, 0.48], dtype=np.float32)
CLOUD = np.array([1.05, 1.05, 1.06], dtype=np.float32)


def sky_colour(rays: Float32Array) -> Float32Array:
    """Colour (N, 3) of the sky along unit rays (N, 3)."""
    up = np.maximum(rays[:, 2], np.float32(0.0))
    blend = ((1 - up) ** 3.5)[:, None]
    clear = ZENITH * (1 - blend) + HAZE * blend
    slant = np.maximum(up, np.float32(0.02))
    across, ahead = (rays[:, :2] / slant[:, None] + np.float32(40)).T
    noise = _clouds().smooth(across, ahead)
    cover = np.clip((noise - 0.25) * 0.75, 0, 1) * np.clip(up * 7 - 0.15, 0, 1) * 0.8
    return np.asarray(clear * (1 - cover[:, None]) + CLOUD * cover[:, None], dtype=np.float32)


@cache
def _clouds() -> Texture:
    return Texture(fractal_noise(7, 512, slope=1.3), step_m=0.05)
