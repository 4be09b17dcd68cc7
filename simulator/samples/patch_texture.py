"""The colour of a road patch seen straight from above: asphalt around a relief, without light and shadows of a day."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.painting.paint_relief import paint_relief
from simulator.painting.texture import Texture, fractal_noise
from simulator.painting.view import rgb
from simulator.shapes.relief import Relief

ASPHALT = rgb(0.088, 0.088, 0.088)
GRAIN_M, MOTTLE_M, STAIN_M = 0.003, 0.03, 0.35
"""Texel sizes: aggregate, its mottling, stains; as on the simulator's own roads, with a finer grain."""

FINEST_TEXEL_M, MOST_TEXELS = 0.002, 1024
"""Two thirds of the grain; and along the longer side."""

SHADED_SHARE = 0.6
"""Of the sky's light that walls keep from a floor; engines light a texture, but not from inside a hole."""


def patch_texture(relief: Relief, half_size_m: tuple[float, float], seed: int) -> NDArray[np.uint8]:
    """Picture (H, W, 3) uint8 BGR (sRGB) of a patch of that half length and half width, x to the right, y upwards.

    Its texture coordinates are those of `patch_mesh`.
    """
    texel_m = max(2 * max(half_size_m) / MOST_TEXELS, FINEST_TEXEL_M)
    columns, rows = (max(1, round(2 * half / texel_m)) for half in half_size_m)
    x = ((np.arange(columns) + 0.5) / columns * 2 - 1) * half_size_m[0]
    y = (1 - (np.arange(rows) + 0.5) / rows * 2) * half_size_m[1]
    u, v = (axis.ravel() for axis in np.meshgrid(x, y))
    near_u, near_v = u.astype(np.float32), v.astype(np.float32)
    seeds = np.random.default_rng([seed, 4]).integers(0, 2**31, 3)
    grain = Texture(fractal_noise(int(seeds[0]), 1024, slope=0.0), GRAIN_M).smooth(near_u, near_v)
    mottle = Texture(fractal_noise(int(seeds[1]), 1024, slope=0.7), MOTTLE_M).smooth(near_u, near_v)
    stains = Texture(fractal_noise(int(seeds[2]), 512, slope=1.1), STAIN_M).smooth(near_u, near_v)
    tone = np.maximum(1 + 0.28 * grain + 0.10 * mottle + 0.10 * stains, 0.25)
    colour = np.asarray(ASPHALT * tone[:, None], dtype=np.float32)
    seen_sky = np.ones(len(u), dtype=np.float32)
    paint_relief(relief, u, v, grain, mottle, colour, seen_sky)
    colour *= (1 - SHADED_SHARE * (1 - seen_sky))[:, None]
    return _srgb(colour).reshape(rows, columns, 3)


def _srgb(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Linear RGB as BGR bytes (IEC 61966-2-1)."""
    light = np.clip(linear, 0, 1)
    curve = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.ascontiguousarray(np.rint(255 * curve).astype(np.uint8)[..., ::-1])
