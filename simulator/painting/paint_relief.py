"""How broken asphalt, gravel, water and repairs look: painted over a road, or over a patch's texture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.painting.sky import Daylight
from simulator.painting.view import View, blend, rgb
from simulator.shapes.relief import Material, Relief

Float32Array = NDArray[np.float32]
FloatArray = NDArray[np.float64]

EXPOSED, STONES, DUST = rgb(0.052, 0.049, 0.045), rgb(0.102, 0.091, 0.077), rgb(0.20, 0.17, 0.13)
FRESH_ASPHALT, SEALANT = rgb(0.040, 0.040, 0.043), rgb(0.016, 0.016, 0.018)
MUDDY_WATER, WET = rgb(0.036, 0.031, 0.024), np.float32(0.55)
WHITE = rgb(0.55, 0.54, 0.50)

HALO_SCALES = (1.05, 1.12, 1.20, 1.30, 1.45, 1.60)
"""Enlarged footprints whose mean is a soft ring around a hole."""


WET_ABOVE_WATER_M = 0.012
"""Capillary rise in a broken edge: a dark band around a puddle."""


def paint_relief(
    relief: Relief,
    u_m: FloatArray,
    v_m: FloatArray,
    grain: Float32Array,
    mottle: Float32Array,
    colour: Float32Array,
    openness: Float32Array,
) -> NDArray[np.bool_]:
    """Overwrite the albedo `colour` (N, 3) and the share of the sky seen `openness` (N,) at local positions (N,).

    `grain` and `mottle` (N,) are noise of unit variance, fine and coarse. Returns where water is seen (N,).
    """
    height_m = relief.height_at(u_m, v_m).astype(np.float32)
    material = relief.material_at(u_m, v_m)
    if relief.is_hole:
        _paint_hole(relief, height_m, u_m, v_m, grain, mottle, colour, openness)
    else:
        _paint_rise(relief, height_m, u_m, v_m, mottle, colour)
    gravel = material == Material.GRAVEL
    stones = np.maximum(1 + 0.38 * grain + 0.20 * mottle, 0.3)[:, None]
    colour[gravel] = (STONES * stones)[gravel]
    patch = material == Material.PATCH
    colour[patch] = (FRESH_ASPHALT * (1 + 0.20 * grain + 0.08 * mottle)[:, None])[patch]
    _seal(relief, u_m, v_m, patch, colour)
    mark = material == Material.MARK
    colour[mark] = (WHITE * np.clip(1 - 0.10 * mottle - 0.08 * grain, 0.6, 1.1)[:, None])[mark]
    water = material == Material.WATER
    if water.any():
        level_m = height_m[water].min()
        wet = (height_m < level_m + WET_ABOVE_WATER_M) & relief.covers(u_m / 1.08, v_m / 1.08)
        colour[wet] *= WET
        colour[water] = MUDDY_WATER * (1 + 0.06 * mottle[water])[:, None]
        openness[water] = 1
    return np.asarray(water)


def mirrored_sky(view: View, daylight: Daylight) -> Float32Array:
    """Light (N, 3) of the sky in level water (Fresnel's share after Schlick 1994)."""
    up = view.ray * np.array([1, 1, -1], dtype=np.float32)
    share = 0.02 + 0.98 * (1 - np.clip(up[:, 2], 0, 1)) ** 5
    return np.asarray(daylight.sky_colour(up) * share[:, None], dtype=np.float32)


def _paint_hole(
    relief: Relief,
    height_m: Float32Array,
    u_m: FloatArray,
    v_m: FloatArray,
    grain: Float32Array,
    mottle: Float32Array,
    colour: Float32Array,
    openness: Float32Array,
) -> None:
    """Walls of fresh fracture, then the base layer's stones on the floor; dust and loose grains around."""
    deep_m = np.maximum(-height_m, 0)
    deep = deep_m / np.float32(max(relief.relief_m, 0.02))
    broken = np.maximum(1 + 0.40 * grain + 0.28 * mottle, 0.25)[:, None]
    floor = blend(EXPOSED, STONES, np.clip(deep * 1.9 - 0.75 + 0.22 * mottle, 0, 0.75)) * broken
    inside = relief.covers(u_m, v_m)
    colour[:] = blend(colour, floor, (inside * np.clip(deep_m / 0.008, 0, 1)).astype(np.float32))
    openness[:] = np.where(inside, 1 - 0.70 * np.clip(deep, 0, 1), openness)
    halo = np.mean([relief.covers(u_m / scale, v_m / scale) for scale in HALO_SCALES], axis=0) * ~inside
    # Tired asphalt cracks around a hole before it breaks out; the cracks follow the noise's zero crossings.
    cracked = np.clip(1 - np.abs(mottle) / 0.10, 0, 1) * np.clip(halo * 1.6 - 0.3, 0, 1)
    colour *= (1 - 0.55 * cracked).astype(np.float32)[:, None]
    dust = np.clip(0.10 + 0.22 * mottle + 0.10 * grain, 0, 0.6) * halo
    colour[:] = blend(colour, DUST, dust.astype(np.float32))


def _paint_rise(
    relief: Relief,
    height_m: Float32Array,
    u_m: FloatArray,
    v_m: FloatArray,
    mottle: Float32Array,
    colour: Float32Array,
) -> None:
    """Worn bright on top, with cracks that run down from it as where a root lifts the road."""
    height = height_m / np.float32(relief.relief_m)
    web = np.abs(np.sin(7 * np.arctan2(v_m, u_m) + 2.5 * mottle)) < 0.10
    cracked = web & (height > 0.15) & (height < 0.9)
    colour *= (1 + 0.18 * np.clip(2 * height, 0, 1) - 0.45 * cracked).astype(np.float32)[:, None]


def _seal(relief: Relief, u_m: FloatArray, v_m: FloatArray, patch: NDArray[np.bool_], colour: Float32Array) -> None:
    """Bitumen along the edge of a patch: where the material a centimetre away is another one."""
    edge = np.zeros(len(u_m), dtype=bool)
    for du, dv in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        away = relief.material_at(u_m + du * relief.step_m, v_m + dv * relief.step_m)
        edge |= patch & (away != Material.PATCH)
    colour[edge] = SEALANT
