"""Houses with windows and doors, and parked cars with glass, lamps and wheels, painted in their own frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.painting.sky import Daylight
from simulator.painting.view import Paint, View, blend, cell_value, repeated, rgb, step, stripe
from simulator.scene import car

Float32Array = NDArray[np.float32]

GLASS, FRAME, DOOR = rgb(0.015, 0.018, 0.022), rgb(0.62, 0.60, 0.55), rgb(0.12, 0.07, 0.04)
SHUTTERS = (rgb(0.10, 0.18, 0.14), rgb(0.16, 0.09, 0.05), rgb(0.12, 0.16, 0.22))
RUBBER, ALLOY, TAIL_LAMP, HEAD_LAMP = (
    rgb(0.018, 0.018, 0.018),
    rgb(0.42, 0.42, 0.43),
    rgb(0.38, 0.012, 0.01),
    rgb(0.70, 0.72, 0.74),
)

BAY_M, STOREY_M, SILL_M = 2.6, 2.9, 0.95
WINDOW_HALF_WIDTH_M, WINDOW_HEIGHT_M = 0.52, 1.35


def paint_facade(
    view: View,
    local_m: Float32Array,
    normal: Float32Array,
    colour: Float32Array,
    plaster: Float32Array,
    daylight: Daylight,
) -> Paint:
    """Plaster with a window in each bay and storey, doors on the ground floor, shutters beside some windows.

    `local_m` and `normal` (N, 3) are in the house's frame, `colour` (N, 3) its plaster's, `plaster` (N,) brightness.
    """
    across = np.where(np.abs(normal[:, 1]) > 0.5, local_m[:, 0], local_m[:, 1])
    z, pixel = local_m[:, 2], view.pixel_m
    bay, storey = np.rint(across / BAY_M), np.floor(z / STOREY_M)
    u, v = repeated(across, BAY_M), z - storey * np.float32(STOREY_M)
    dice = cell_value(bay * 7 + storey * 131 + 5, view.part.astype(np.float32))
    top = (storey >= 0) & (v < STOREY_M)
    is_door = (storey == 0) & (dice < 0.22)
    low = np.where(is_door, np.float32(0.02), np.float32(SILL_M))
    height_inside = np.minimum(v - low, SILL_M + WINDOW_HEIGHT_M - v)
    inside = np.minimum(WINDOW_HALF_WIDTH_M - np.abs(u), height_inside)
    opening = step(inside, 0.0, pixel) * top * (np.abs(normal[:, 2]) < 0.3)
    pane = step(inside, 0.06, pixel) * (1 - stripe(u, 0.025, pixel)) * ~is_door * opening
    beside = np.abs(np.abs(u) - np.float32(WINDOW_HALF_WIDTH_M + 0.26))
    shutter = step(np.minimum(np.float32(0.24) - beside, height_inside), 0.0, pixel)
    shutter *= (dice > 0.45) & top & ~is_door
    slats = 1 - 0.35 * stripe(repeated(v, 0.08), 0.012, pixel)
    wall = colour * (plaster * np.where(z < 0.55, np.float32(0.72), np.float32(1.0)))[:, None]
    shutters = np.stack(SHUTTERS)[view.part % len(SHUTTERS)] * slats[:, None]
    albedo = blend(blend(wall, shutters, shutter), np.where(is_door[:, None], DOOR, FRAME), opening)
    albedo = blend(albedo, GLASS, pane)
    mirrored = daylight.sky_colour(_mirrored(view)) * (0.10 + 0.35 * dice * dice)[:, None]
    lintel = 1 - 0.35 * np.clip(1 - np.abs(inside + 0.02) / 0.08, 0, 1)
    return Paint(albedo, (mirrored * pane[:, None]).astype(np.float32), (0.92 * lintel).astype(np.float32))


def paint_car(
    view: View, local_m: Float32Array, normal: Float32Array, colour: Float32Array, daylight: Daylight
) -> Paint:
    """Lacquer, glass behind pillars, lamps, wheel arches and door seams; `local_m`, `normal` in the car's frame."""
    x, y, z = local_m.T
    pixel = view.pixel_m
    belt, roof = (f(x).astype(np.float32) for f in (car.belt_height, car.roof_height))
    width = car.half_width(x).astype(np.float32)
    side = np.abs(normal[:, 1]) > 0.55
    seams = sum(stripe(x - at, 0.006, pixel) for at in (-0.98, 0.05, 0.98))
    pillars = stripe(x - 0.05, 0.04, pixel) + stripe(x + 0.98, 0.035, pixel)
    side_glass = step(np.minimum(z - belt - 0.045, roof - 0.075 - z), 0.0, pixel) * (1 - pillars) * (x > -1.72)
    screen_x = np.minimum(np.abs(x - np.float32(0.74)) - 0.34, np.abs(x + np.float32(1.80)) - 0.16)
    screen_glass = step(np.minimum(0.70 * width - np.abs(y), -screen_x), 0.0, pixel) * (z > belt + 0.03)
    glass = np.where(side, side_glass, screen_glass)
    tail = ((x < -1.93) & (np.abs(y) > 0.50) & (z > 0.66) & (z < 0.90)).astype(np.float32)
    head = ((x > 1.80) & (np.abs(y) > 0.42) & (z > 0.56) & (z < 0.70)).astype(np.float32)
    trim = ((z < 0.30) | ((x < -2.0) & (z < 0.50)) | ((x > 2.02) & (z < 0.44))).astype(np.float32)
    plate = ((np.abs(y) < 0.26) & (np.abs(x) > 2.05) & (z > 0.50) & (z < 0.61)).astype(np.float32)
    arch_m = np.min([np.hypot(x - axle, z - car.WHEEL_RADIUS_M) for axle in car.AXLES_X_M], axis=0)
    arch = step(-arch_m, -0.375, pixel) * (np.abs(y) > 0.6)
    albedo = colour * (1 - 0.75 * np.clip(seams, 0, 1) * side * (z < belt) * (z > 0.30))[:, None]
    for share, tint in (
        (trim, RUBBER),
        (tail, TAIL_LAMP),
        (head, HEAD_LAMP),
        (plate, FRAME),
        (glass, GLASS),
        (arch, RUBBER),
    ):
        albedo = blend(albedo, tint, np.asarray(share, dtype=np.float32))
    # Schlick's approximation: lacquer and glass mirror 4 % head on and all at a grazing angle.
    fresnel = 0.04 + 0.96 * (1 - view.cosine) ** 5
    shiny = (1 - trim) * (1 - arch) * (fresnel + 0.10 * glass)
    sky = daylight.sky_colour(_mirrored(view)) * np.where(_mirrored(view)[:, 2:] > 0, np.float32(1), np.float32(0.22))
    return Paint(
        albedo, np.asarray(sky * shiny[:, None], dtype=np.float32), np.clip(0.25 + z, 0.3, 1).astype(np.float32)
    )


def paint_wheel(view: View, local_m: Float32Array, normal: Float32Array) -> Paint:
    """Tyre and five-spoke rim."""
    x, _, z = local_m.T
    dx = np.where(x > 0, x - np.float32(car.AXLES_X_M[1]), x - np.float32(car.AXLES_X_M[0]))
    dz = z - np.float32(car.WHEEL_RADIUS_M)
    radius, angle = np.hypot(dx, dz), np.arctan2(dz, dx)
    spoke = np.cos(5 * angle) > -0.25
    face = np.abs(normal[:, 1]) > 0.7
    rim = ((radius < 0.21) & (spoke | (radius > 0.185) | (radius < 0.06)) & face).astype(np.float32)
    return Paint.matt(blend(RUBBER, ALLOY, rim), 0.6)


def _mirrored(view: View) -> Float32Array:
    """Directions (N, 3) of the mirrored rays."""
    along = np.einsum("ij,ij->i", view.ray, view.normal)
    return np.asarray(view.ray - 2 * along[:, None] * view.normal)
