"""The land between the roads and hills on the horizon."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from simulator.mesh import grid
from simulator.scene.roadside import VERGE_WIDTH_M
from simulator.scene.scenery import Part, Surface
from simulator.streets.road import Road
from simulator.streets.street import Street

FloatArray = NDArray[np.float64]

NEAR_STEP_M, NEAR_M = 2.5, 30.0
FAR_LINES_M = np.array([35.0, 45.0, 60.0, 85.0, 120.0, 180.0, 300.0, 520.0, 800.0])
"""Beyond the roads' box the land is flat and its lattice wide."""

PROFILE_M = np.array([[0.0, 2.6, 6.0, 150.0, 800.0], [-0.45, -0.45, 0.14, 1.5, 3.0]])
"""Outside a road's borders: below them for a cell, so that no corner pokes through, then a verge that rises."""

HILL_RADIUS_M = 1_300.0


class Clearance:
    """Distance of positions to the nearest road's borders, and that road's height there."""

    def __init__(self, street: Street) -> None:
        self._roads = [_Strip(road) for road in street.roads]
        self._low = np.array([road.low for road in self._roads])
        self._high = np.array([road.high for road in self._roads])
        self._widest = np.array([road.borders.max() for road in self._roads])

    def at(self, xy_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance (N,) from the borders, negative inside them, and height (N,) of that road, of positions (N, 2)."""
        outside, height = np.full(len(xy_m), np.inf), np.zeros(len(xy_m))
        beyond = np.maximum(np.maximum(self._low - xy_m.max(axis=0), xy_m.min(axis=0) - self._high), 0)
        least = np.hypot(beyond[:, 0], beyond[:, 1]) - self._widest
        for index in np.argsort(least, kind="stable"):
            if least[index] >= outside.max():
                break
            road = self._roads[index]
            maybe = np.flatnonzero(road.least_outside(xy_m) < outside)
            if maybe.size:
                distance, at = road.outside(xy_m[maybe])
                nearer = distance < outside[maybe]
                outside[maybe[nearer]], height[maybe[nearer]] = distance[nearer], at[nearer]
        return outside, height


class _Strip:
    """A road between its borders, sampled each metre."""

    def __init__(self, road: Road) -> None:
        s = np.linspace(road.line.start_m, road.line.end_m, max(2, round(road.line.length_m) + 1))
        at = road.line.at(s)
        self._points, self._heights = at.position_m[:, :2], at.position_m[:, 2]
        self._left = np.stack([-np.sin(at.heading_rad), np.cos(at.heading_rad)], axis=1)
        pavements = np.array([road.section.pavement_width_m if road.has_kerb(side) else 0.0 for side in (1, -1)])
        self.borders = road.half_width(s)[:, None] + VERGE_WIDTH_M + pavements
        self._tree = cKDTree(self._points)
        self.low, self.high = self._points.min(axis=0), self._points.max(axis=0)

    def least_outside(self, xy_m: FloatArray) -> FloatArray:
        """No position (N, 2) is nearer (N,) to the borders than by the road's box."""
        beyond = np.maximum(np.maximum(self.low - xy_m, xy_m - self.high), 0)
        return np.asarray(np.hypot(beyond[:, 0], beyond[:, 1]) - self.borders.max())

    def outside(self, xy_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance (N,) from the borders, negative inside, and height (N,) of the road at positions (N, 2)."""
        to_line, nearest = self._tree.query(xy_m)
        index = np.asarray(nearest)
        on_left = np.einsum("ij,ij->i", xy_m - self._points[index], self._left[index]) > 0
        return to_line - np.where(on_left, *self.borders[index].T), self._heights[index]


def land(street: Street, clearance: Clearance) -> Part:
    """A lattice that follows the roads' heights, and lies below them."""
    lines = [road.line.at(np.linspace(road.line.start_m, road.line.end_m, 50)).position_m for road in street.roads]
    box = np.concatenate(lines)[:, :2]
    x, y = np.meshgrid(*(_lines(float(low), float(high)) for low, high in zip(box.min(0), box.max(0), strict=True)))
    outside, height = clearance.at(np.stack([x.ravel(), y.ravel()], axis=1))
    z = (height + np.interp(outside, *PROFILE_M)).reshape(x.shape)
    return Part(Surface.GROUND, grid(np.stack([x, y, z], axis=-1)))


def hills(rng: np.random.Generator, centre_m: FloatArray) -> Part:
    """A ring of hills on the horizon."""
    azimuth = np.linspace(0, 2 * np.pi, 361)
    waves = sum(rng.uniform(5, 14) / k**0.5 * np.cos(k * azimuth + rng.uniform(0, 6)) for k in range(2, 16))
    ridge_m = np.maximum(52 + np.asarray(waves), 14)
    x, y = HILL_RADIUS_M * np.cos(azimuth), HILL_RADIUS_M * np.sin(azimuth)
    foot = np.stack([x * 0.6, y * 0.6, 0 * x - 4], -1)
    return Part(
        Surface.HILL, grid(np.stack([foot, np.stack([x, y, ridge_m], -1)]) + centre_m), colour=(0.11, 0.15, 0.07)
    )


def _lines(low: float, high: float) -> FloatArray:
    low, high = low - NEAR_M, high + NEAR_M
    near = np.linspace(low, high, round((high - low) / NEAR_STEP_M) + 1)
    return np.concatenate([low + NEAR_M - FAR_LINES_M[::-1], near, high - NEAR_M + FAR_LINES_M])
