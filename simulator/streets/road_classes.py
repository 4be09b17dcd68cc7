"""What a hit on a carriageway is: asphalt, paint, an iron cover, or water in a hole."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulator.scene.scenery import Surface
from simulator.shapes.relief import Material, Relief
from simulator.streets.road_layout import DASH_M, DASH_PERIOD_M, PaintedLine
from simulator.streets.street import Feature, Street

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]


TOLD = {Material.WATER: Surface.WATER, Material.MARK: Surface.ROAD_MARK}
"""Materials of a relief that are more than road; a hump's white triangles are marks too."""


class RoadClasses:
    """Classes of hits on the roads of one street."""

    def __init__(self, street: Street) -> None:
        self._lines = [[_LineTable(line) for line in road.lines()] for road in street.roads]
        self._covers = [feature for feature in street.features if feature.kind is Feature.MANHOLE]
        shapes = ((placed, placed.shape) for placed in street.obstacles if not placed.filled)
        self._reliefs = [
            (placed, shape)
            for placed, shape in shapes
            if isinstance(shape, Relief) and shape.materials is not None and np.isin(shape.materials, list(TOLD)).any()
        ]

    def of(self, road: NDArray[np.intp], road_m: Float32Array, points_m: Float32Array) -> NDArray[np.uint8]:
        """`Surface` (N,) of hits on the roads of an index (N,), at road positions (N, 3) and points (N, 3) `street`."""
        surface = np.full(len(road), Surface.ROAD, dtype=np.uint8)
        for index in np.unique(road):
            chosen = np.flatnonzero(road == index)
            s, t = road_m[chosen, 0], road_m[chosen, 1]
            for line in self._lines[index]:
                surface[chosen[line.covers(s, t)]] = Surface.ROAD_MARK
        for cover in self._covers:
            near = _within(points_m, cover.x_m, cover.y_m, cover.shape.length_m / 2)
            surface[near] = Surface.MANHOLE
        for placed, relief in self._reliefs:
            near = _within(points_m, placed.x_m, placed.y_m, relief.reach_m)
            u, v = placed.local(points_m[near, 0].astype(np.float64), points_m[near, 1].astype(np.float64))
            material = relief.material_at(u, v)
            for told, as_surface in TOLD.items():
                surface[near[material == told]] = as_surface
        return surface


class _LineTable:
    """A painted line as arrays."""

    def __init__(self, line: PaintedLine) -> None:
        self._offsets = np.ascontiguousarray(line.offset_m, dtype=np.float64)
        self._ends = (line.from_m, line.to_m, line.width_m / 2)
        self._dash_m = DASH_M / 2 if line.dashed else math.inf

    def covers(self, s_m: Float32Array, t_m: Float32Array) -> NDArray[np.intp]:
        """Indices of the road positions (N,) on its paint."""
        index: NDArray[np.intp] = _on_line(s_m, t_m, self._offsets, *self._ends, self._dash_m, DASH_PERIOD_M)
        return index


@njit(cache=True, nogil=True)
def _on_line(
    s_m: Float32Array,
    t_m: Float32Array,
    offsets: FloatArray,
    from_m: float,
    to_m: float,
    half_width_m: float,
    half_dash_m: float,
    period_m: float,
) -> NDArray[np.intp]:
    low, high = offsets[:, 1].min() - half_width_m, offsets[:, 1].max() + half_width_m
    found = np.empty(len(s_m), dtype=np.intp)
    count = 0
    for i in range(len(s_m)):
        s, t = s_m[i], t_m[i]
        if t < low or t > high or s < from_m or s > to_m:
            continue
        if abs(s - period_m * np.rint(s / period_m)) > half_dash_m:
            continue
        k = min(max(np.searchsorted(offsets[:, 0], s), 1), len(offsets) - 1)
        s0, s1 = offsets[k - 1, 0], offsets[k, 0]
        share = min(max((s - s0) / (s1 - s0), 0.0), 1.0) if s1 > s0 else 0.0
        if abs(t - offsets[k - 1, 1] - share * (offsets[k, 1] - offsets[k - 1, 1])) <= half_width_m:
            found[count] = i
            count += 1
    return found[:count]


@njit(cache=True, nogil=True)
def _within(points_m: Float32Array, x_m: float, y_m: float, radius_m: float) -> NDArray[np.intp]:
    """Indices of the points (N, 3) within a radius in plan."""
    found = np.empty(len(points_m), dtype=np.intp)
    count = 0
    for i in range(len(points_m)):
        if (points_m[i, 0] - x_m) ** 2 + (points_m[i, 1] - y_m) ** 2 <= radius_m**2:
            found[count] = i
            count += 1
    return found[:count]
