"""What patches, manhole covers and joints look like."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.painting.view import View, blend, repeated, rgb, step, stripe
from simulator.streets.street import Feature, PlacedFeature

Float32Array = NDArray[np.float32]

IRON, RUST, BITUMEN = rgb(0.060, 0.056, 0.052), rgb(0.13, 0.075, 0.045), rgb(0.022, 0.022, 0.024)
PATCH_SHADE = 0.62
COVER_PATTERN_M = 0.05


def paint_feature(
    feature: PlacedFeature, view: View, grain: Float32Array, mottle: Float32Array, colour: Float32Array
) -> None:
    """Overwrite the colours (N, 3) of hits on one feature; `grain` and `mottle` (N,) are the asphalt's."""
    reach = feature.shape.reach_m
    x, y = view.point_m[:, 0], view.point_m[:, 1]
    near = np.flatnonzero((np.abs(x - feature.x_m) < reach) & (np.abs(y - feature.y_m) < reach))
    if not near.size:
        return
    u, v = feature.local(x[near].astype(np.float64), y[near].astype(np.float64))
    half_length, half_width = feature.shape.length_m / 2, feature.shape.width_m / 2
    pixel, around = view.pixel_m[near], colour[near]
    rectangle = np.minimum(half_length - np.abs(u), half_width - np.abs(v)).astype(np.float32)
    match feature.kind:
        case Feature.PATCH:
            fresh = around * np.float32(PATCH_SHADE) * (1 + 0.10 * mottle[near])[:, None]
            painted = blend(around, fresh, step(rectangle, 0.0, pixel))
            painted = blend(painted, BITUMEN, 0.8 * stripe(rectangle, 0.015, pixel))
        case Feature.MANHOLE:
            radius = np.hypot(u, v).astype(np.float32)
            knobs = stripe(repeated(u.astype(np.float32), COVER_PATTERN_M), 0.012, pixel)
            knobs = knobs * stripe(repeated(v.astype(np.float32), COVER_PATTERN_M), 0.012, pixel)
            iron = blend(IRON, RUST, np.clip(0.35 + 0.3 * mottle[near], 0, 1)) * (1 + 0.9 * knobs)[:, None]
            painted = blend(around, iron, step(np.float32(half_length) - radius, 0.0, pixel))
            painted = blend(painted, BITUMEN, stripe(radius - np.float32(half_length - 0.05), 0.012, pixel))
        case Feature.JOINT:
            painted = blend(around, BITUMEN * (1 + 0.2 * grain[near])[:, None], step(rectangle, 0.0, pixel))
    colour[near] = painted
