"""The road's colour: grain, patches, wheel tracks, cracks, worn marks, and broken asphalt in the holes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.paint_feature import paint_feature
from simulator.paint_relief import mirrored_sky, paint_relief
from simulator.pothole import Relief
from simulator.road import Road, Section
from simulator.sky import Daylight
from simulator.street import PlacedObstacle, Street
from simulator.texture import Texture, fractal_noise
from simulator.view import Paint, View, blend, repeated, rgb, step, stripe

Float32Array = NDArray[np.float32]

ASPHALT, FRESH_ASPHALT = rgb(0.088, 0.088, 0.088), rgb(0.040, 0.040, 0.043)
DUST, WHITE = rgb(0.20, 0.17, 0.13), rgb(0.62, 0.61, 0.57)

GRAIN_M, MOTTLE_M, PATCH_M = 0.004, 0.03, 0.35
"""Texel sizes: aggregate of asphalt concrete, its mottling, and stains."""

WHEEL_TRACK_HALF_M = 0.75
DASH_M, DASH_PERIOD_M = 3.0, 7.5
MARK_HALF_WIDTH_M, EDGE_MARK_INSET_M = 0.06, 0.3
STOP_LINE_M, STOP_LINE_HALF_M = 7.5, 0.15
"""A side road's traffic stops before the footway that crosses its mouth."""


class AsphaltPaint:
    """Paint of one street's roads."""

    def __init__(self, street: Street, daylight: Daylight) -> None:
        self._street, self._daylight = street, daylight
        seeds = np.random.default_rng([street.seed, 2]).integers(0, 2**31, 4)
        self._grain = Texture(fractal_noise(int(seeds[0]), 1024, slope=0.0), GRAIN_M)
        self._mottle = Texture(fractal_noise(int(seeds[1]), 1024, slope=0.7), MOTTLE_M)
        self._stains = Texture(fractal_noise(int(seeds[2]), 512, slope=1.1), PATCH_M)
        self._repairs = _repairs(street, np.random.default_rng(int(seeds[3])))

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
                self._street.roads[index], view.only(chosen), along[chosen], tone[chosen], mottle[chosen], grain[chosen]
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
        road: Road,
        view: View,
        along: Float32Array,
        tone: Float32Array,
        mottle: Float32Array,
        grain: Float32Array,
    ) -> Float32Array:
        """Colour (N, 3) of one road: tracks, repairs, cracks, marks, dust in the gutters."""
        s, t, _ = view.road_m.T
        edge = road.half_width(s).astype(np.float32)
        colour = ASPHALT * np.maximum(tone - _polish(road.section, t), 0.25)[:, None]
        if road is self._street.main:
            self._repair(colour, s, t, view.pixel_m)
        colour *= 1 - 0.62 * self._cracks(s, t, along)[:, None]
        if road.marked:
            share = _marks(road, s, t, view.pixel_m, along) * np.clip(0.80 - 0.28 * mottle - 0.22 * grain, 0.05, 0.92)
            colour = blend(colour, WHITE * (1 + 0.10 * grain)[:, None], share)
        gutter = np.clip((np.abs(t) - edge + 0.45) / 0.45, 0, 1) * np.clip(0.45 + 0.25 * mottle, 0, 1)
        return blend(colour, DUST * np.float32(0.7), gutter * np.float32(0.6))

    def _repair(self, colour: Float32Array, x: Float32Array, y: Float32Array, pixel: Float32Array) -> None:
        """Darker rectangles where the road was opened, sealed with bitumen."""
        for x0, y0, half_length, half_width, shade in self._repairs:
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


def _marks(road: Road, s: Float32Array, t: Float32Array, pixel: Float32Array, along: Float32Array) -> Float32Array:
    """Share of white paint: dashes between lanes, solid edges that end at openings, a stop line where a road joins."""
    section = road.section
    dashes = stripe(repeated(s, DASH_PERIOD_M), DASH_M / 2, along)
    borders = [section.lane_offset_m(lane) + section.lane_width_m / 2 for lane in range(len(section.lanes) - 1)]
    share = dashes * sum((stripe(t - np.float32(b), MARK_HALF_WIDTH_M, pixel) for b in borders), np.zeros_like(t))
    edge = stripe(np.abs(t) - np.float32(section.half_width_m - EDGE_MARK_INSET_M), 0.05, pixel)
    for opening in road.openings:
        edge *= ~((s > opening.start_m) & (s < opening.end_m) & (np.sign(t) == opening.side))
    share = share + 0.75 * edge
    if road.joins is None:
        return np.asarray(share, dtype=np.float32)
    from_start = s - np.float32(road.line.start_m)
    arriving = (t > 0) & (t < section.half_width_m - EDGE_MARK_INSET_M)
    line = stripe(from_start - np.float32(STOP_LINE_M), STOP_LINE_HALF_M, along) * arriving
    return np.asarray(np.where(from_start > STOP_LINE_M, share, 0) + line, dtype=np.float32)


def _polish(section: Section, t: Float32Array) -> Float32Array:
    """Tyres polish and darken their paths; oil darkens the middle of a lane a little."""
    lanes = [section.lane_offset_m(lane) for lane in range(len(section.lanes))]
    paths = [lane + side for lane in lanes for side in (-WHEEL_TRACK_HALF_M, WHEEL_TRACK_HALF_M)]
    polish = sum((np.exp(-np.square((t - np.float32(path)) / 0.34)) for path in paths), np.zeros_like(t))
    oil = sum((np.exp(-np.square((t - np.float32(lane)) / 0.30)) for lane in lanes), np.zeros_like(t))
    return np.asarray(0.20 * polish + 0.07 * oil, dtype=np.float32)


def _repairs(street: Street, rng: np.random.Generator) -> list[tuple[float, float, float, float, float]]:
    """Rectangles (x, y, half length, half width, shade) across the whole drawn road, off the obstacles."""
    repairs = []
    for x in np.arange(-80.0, street.length_m + 100.0, 17.0):
        place = (x + rng.uniform(-5, 5), rng.uniform(-2.6, 2.6))
        size = (rng.uniform(0.4, 2.2), rng.uniform(0.25, 0.8))
        if all(abs(place[0] - placed.x_m) > size[0] + 1.5 for placed in street.obstacles):
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
