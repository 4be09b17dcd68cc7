"""The road's colour: grain, patches, wheel tracks, cracks, worn marks, and broken asphalt in the holes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.painting.paint_feature import paint_feature
from simulator.painting.paint_relief import mirrored_sky, paint_relief
from simulator.painting.sky import Daylight
from simulator.painting.texture import Texture, fractal_noise
from simulator.painting.view import Paint, View, blend, repeated, rgb, step, stripe
from simulator.shapes.relief import Relief
from simulator.streets.road import EDGE_LINE_INSET_M, STOP_LINE_M, Road
from simulator.streets.road_layout import DASH_M, DASH_PERIOD_M, PaintedLine
from simulator.streets.street import PlacedObstacle, Street

Float32Array = NDArray[np.float32]

ASPHALT, FRESH_ASPHALT = rgb(0.088, 0.088, 0.088), rgb(0.040, 0.040, 0.043)
DUST = rgb(0.20, 0.17, 0.13)
LINE_COLOURS = {"white": rgb(0.62, 0.61, 0.57), "yellow": rgb(0.62, 0.40, 0.06)}

GRAIN_M, MOTTLE_M, PATCH_M = 0.004, 0.03, 0.35
"""Texel sizes: aggregate of asphalt concrete, its mottling, and stains."""

WHEEL_TRACK_HALF_M = 0.75
STOP_LINE_HALF_M = 0.15
REPAIR_SPACING_M, REPAIR_EDGE_M = 17.0, 0.9


class AsphaltPaint:
    """Paint of one street's roads."""

    def __init__(self, street: Street, daylight: Daylight) -> None:
        self._street, self._daylight = street, daylight
        seeds = np.random.default_rng([street.seed, 2]).integers(0, 2**31, 4)
        self._grain = Texture(fractal_noise(int(seeds[0]), 1024, slope=0.0), GRAIN_M)
        self._mottle = Texture(fractal_noise(int(seeds[1]), 1024, slope=0.7), MOTTLE_M)
        self._stains = Texture(fractal_noise(int(seeds[2]), 512, slope=1.1), PATCH_M)
        repairs = np.random.default_rng(int(seeds[3]))
        self._repairs = [_repairs(street, road, repairs) for road in street.roads]
        self._lines = [road.lines() for road in street.roads]

    def paint(self, view: View, road: NDArray[np.intp]) -> Paint:
        """Colours of hits on carriageways; `road` (N,) is the index of each one's road."""
        x, y = view.point_m[:, 0], view.point_m[:, 1]
        along = view.pixel_m / view.cosine
        grain = self._grain.at(x, y) * np.clip(0.011 / along, 0.08, 1)
        mottle = self._mottle.smooth(x, y)
        tone = 1 + 0.22 * grain + 0.10 * mottle + 0.13 * self._stains.smooth(x, y)
        colour = np.empty_like(view.point_m)
        for index in np.unique(road):
            chosen = np.flatnonzero(road == index)
            colour[chosen] = self._carriageway(
                int(index), view.only(chosen), along[chosen], tone[chosen], mottle[chosen], grain[chosen]
            )
        glow, openness = np.zeros_like(colour), np.ones_like(x)
        for feature in self._street.features:
            paint_feature(feature, view, grain, mottle, colour)
        for placed in self._street.obstacles:
            if isinstance(placed.shape, Relief):
                water = _paint_obstacle(placed, placed.shape, view, grain, mottle, colour, openness)
                glow[water] = mirrored_sky(view.only(water), self._daylight)
        return Paint(colour, glow, openness * self._beside_cars(x, y))

    def _carriageway(
        self,
        index: int,
        view: View,
        along: Float32Array,
        tone: Float32Array,
        mottle: Float32Array,
        grain: Float32Array,
    ) -> Float32Array:
        """Colour (N, 3) of one road: tracks, repairs, cracks, marks, dust in the gutters."""
        road = self._street.roads[index]
        if road.connecting:
            # Connecting roads overlap: which of two is seen must make no difference.
            return np.asarray(ASPHALT * np.maximum(tone, 0.25)[:, None], dtype=np.float32)
        s, t, _ = view.road_m.T
        edge = road.half_width(s).astype(np.float32)
        colour = ASPHALT * np.maximum(tone - _polish(road, s, t), 0.25)[:, None]
        self._repair(index, colour, s, t, view.pixel_m)
        colour *= 1 - 0.62 * self._cracks(s, t, along)[:, None]
        worn = np.clip(0.80 - 0.28 * mottle - 0.22 * grain, 0.05, 0.92)
        for name, paint in LINE_COLOURS.items():
            share = sum(
                (_line(line, s, t, view.pixel_m, along) for line in self._lines[index] if line.colour == name),
                _stop_line(road, s, t, along) if name == "white" else np.zeros_like(s),
            )
            colour = blend(colour, paint * (1 + 0.10 * grain)[:, None], np.minimum(share, 1) * worn)
        gutter = np.clip((np.abs(t) - edge + 0.45) / 0.45, 0, 1) * np.clip(0.45 + 0.25 * mottle, 0, 1)
        return blend(colour, DUST * np.float32(0.7), gutter * np.float32(0.6))

    def _repair(self, index: int, colour: Float32Array, x: Float32Array, y: Float32Array, pixel: Float32Array) -> None:
        """Darker rectangles where the road was opened, sealed with bitumen."""
        for x0, y0, half_length, half_width, shade in self._repairs[index]:
            near = np.flatnonzero(np.abs(x - x0) < half_length + 0.5)
            if near.size:
                inside = np.minimum(half_length - np.abs(x[near] - x0), half_width - np.abs(y[near] - y0))
                shaded = 1 - (1 - shade) * step(inside, 0.0, pixel[near])
                colour[near] *= (shaded * (1 - 0.5 * stripe(inside, 0.02, pixel[near])))[:, None]

    def _cracks(self, x: Float32Array, y: Float32Array, along: Float32Array) -> Float32Array:
        """Share of crack in a pixel: zero crossings of noise where the road is tired, and the joint of the lanes."""
        wander = self._mottle.smooth(x * 0.16 + 3, y * 0.16)
        tired = np.clip(self._stains.smooth(y * 1.7 + 11, x * 0.7) - 0.55, 0, 0.5) * 2
        fade = np.clip(0.03 / along, 0, 1)
        crack = np.exp(-np.square(wander / (0.035 + 0.4 * along))) * tired * fade
        joint = stripe(y - 0.16 - 0.012 * wander, 0.006, along.clip(0.004)) * 0.8
        return np.asarray(np.minimum(crack + joint, 1))

    def _beside_cars(self, x: Float32Array, y: Float32Array) -> Float32Array:
        """Share of the sky seen beside and under the parked cars."""
        openness = np.ones_like(x)
        for parked in self._street.parked_cars:
            cos, sin = np.cos(parked.yaw_rad), np.sin(parked.yaw_rad)
            dx, dy = x - np.float32(parked.x_m), y - np.float32(parked.y_m)
            outside = np.maximum(np.abs(cos * dx + sin * dy) - 1.95, np.abs(cos * dy - sin * dx) - 0.72)
            openness *= np.clip(0.55 + outside / 0.7, 0.12, 1)
        return np.asarray(openness, dtype=np.float32)


def _line(
    line: PaintedLine, s: Float32Array, t: Float32Array, pixel: Float32Array, along: Float32Array
) -> Float32Array:
    """Share of a painted line in each pixel."""
    offset = np.interp(s, *line.offset_m.T).astype(np.float32)
    share = stripe(t - offset, line.width_m / 2, pixel) * np.float32(line.cover)
    if line.dashed:
        share *= stripe(repeated(s, DASH_PERIOD_M), DASH_M / 2, along)
    return np.asarray(np.where((s > line.from_m) & (s < line.to_m), share, 0), dtype=np.float32)


def _stop_line(road: Road, s: Float32Array, t: Float32Array, along: Float32Array) -> Float32Array:
    """Share of the line at which a side road's traffic stops."""
    if road.joins is None:
        return np.zeros_like(s)
    arriving = (t > 0) & (t < road.section.half_width_m - EDGE_LINE_INSET_M)
    from_start = s - np.float32(road.line.start_m)
    return np.asarray(stripe(from_start - np.float32(STOP_LINE_M), STOP_LINE_HALF_M, along) * arriving)


def _polish(road: Road, s: Float32Array, t: Float32Array) -> Float32Array:
    """Tyres polish and darken their paths; oil darkens the middle of a lane a little."""
    polish = np.zeros_like(t)
    for lane in road.lane_offsets(s.astype(np.float64)):
        from_middle = np.abs(t - lane.astype(np.float32))
        polish += 0.20 * np.exp(-np.square((from_middle - np.float32(WHEEL_TRACK_HALF_M)) / 0.34))
        polish += 0.07 * np.exp(-np.square(from_middle / 0.30))
    return polish


def _repairs(street: Street, road: Road, rng: np.random.Generator) -> list[tuple[float, float, float, float, float]]:
    """Rectangles (s, t, half length, half width, shade) along a whole road, off the obstacles."""
    if road.connecting:
        return []
    taken = np.array([(placed.x_m, placed.y_m) for placed in street.obstacles]).reshape(-1, 2)
    taken_s, taken_t = road.line.project(taken) if len(taken) else (np.empty(0), np.empty(0))
    repairs = []
    for s in np.arange(road.line.start_m + REPAIR_SPACING_M, road.line.end_m - 5.0, REPAIR_SPACING_M):
        room = float(road.half_width(np.array([s]))[0]) - REPAIR_EDGE_M
        place = (float(s + rng.uniform(-5, 5)), float(rng.uniform(-1, 1)) * max(room, 0.0))
        size = (rng.uniform(0.4, 2.2), rng.uniform(0.25, 0.8))
        near = (np.abs(taken_s - place[0]) < size[0] + 1.5) & (np.abs(taken_t) < 10.0)
        if not near.any():
            repairs.append((*place, *size, rng.uniform(0.62, 0.85)))
    return repairs


def _paint_obstacle(
    placed: PlacedObstacle,
    relief: Relief,
    view: View,
    grain: Float32Array,
    mottle: Float32Array,
    colour: Float32Array,
    openness: Float32Array,
) -> NDArray[np.intp]:
    """Overwrite the colours around one relief: a patch if filled, else what it is made of; indices of its water."""
    reach = relief.reach_m * 1.15
    x, y = view.point_m[:, 0], view.point_m[:, 1]
    near = np.flatnonzero((np.abs(x - placed.x_m) < reach) & (np.abs(y - placed.y_m) < reach))
    if not near.size:
        return near
    u, v = placed.local(x[near].astype(np.float64), y[near].astype(np.float64))
    if placed.filled:
        margin = np.minimum(relief.length_m * 0.58 - np.abs(u), relief.width_m * 0.60 - np.abs(v)).astype(np.float32)
        patch = FRESH_ASPHALT * (1 + 0.18 * grain[near])[:, None]
        colour[near] = blend(colour[near], patch, step(margin, 0.0, view.pixel_m[near]))
        colour[near] *= 1 - 0.6 * stripe(margin, 0.02, view.pixel_m[near])[:, None]
        return near[:0]
    own, seen_sky = colour[near], openness[near]
    water = paint_relief(relief, u, v, grain[near], mottle[near], own, seen_sky)
    colour[near], openness[near] = own, seen_sky
    return near[water]
