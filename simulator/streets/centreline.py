"""The line that a road follows: a smooth curve in space, measured by the distance s along its plan."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.spatial import cKDTree

FloatArray = NDArray[np.float64]

SAMPLE_M = 1.0
"""Knots of the spline: an arc of 12 m radius between them is met within 2 micrometres (h^4 / (384 R^3))."""

NEWTON_STEPS = 4


@dataclass(frozen=True, slots=True)
class Stations:
    """What the line is at N distances: position (N, 3), heading (counter-clockwise from x), curvature, slope."""

    position_m: FloatArray
    heading_rad: FloatArray
    curvature_per_m: FloatArray
    grade: FloatArray


class Centreline:
    """A curve through (K, 3) points, in the order of driving, at distances `s_m` (K,) that increase."""

    def __init__(self, s_m: FloatArray, points_m: FloatArray) -> None:
        if len(s_m) < 4 or not (np.diff(s_m) > 0).all() or not np.isfinite(points_m).all():
            raise ValueError("a line needs at least four finite points at increasing distances")
        self.start_m, self.end_m = float(s_m[0]), float(s_m[-1])
        self._curve = CubicSpline(s_m, points_m)
        self._slope, self._bend = self._curve.derivative(1), self._curve.derivative(2)
        self._knots_m = np.asarray(s_m, dtype=np.float64)
        self._spacing_m = float(np.diff(s_m).max())
        self._tree = cKDTree(points_m[:, :2])

    @property
    def length_m(self) -> float:
        """Distance between both ends."""
        return self.end_m - self.start_m

    def at(self, s_m: FloatArray) -> Stations:
        """The line at distances (N,); beyond the ends it goes on as its last piece does."""
        position, slope, bend = self._curve(s_m), self._slope(s_m), self._bend(s_m)
        plan = np.hypot(slope[:, 0], slope[:, 1])
        curvature = (slope[:, 0] * bend[:, 1] - slope[:, 1] * bend[:, 0]) / plan**3
        return Stations(position, np.arctan2(slope[:, 1], slope[:, 0]), curvature, slope[:, 2] / plan)

    def plan(self, s_m: FloatArray, t_m: FloatArray) -> FloatArray:
        """(N, 2) positions at distances s, t to the left of the line."""
        position, slope = self._curve(s_m)[:, :2], self._slope(s_m)[:, :2]
        left = np.stack([-slope[:, 1], slope[:, 0]], axis=1) / np.hypot(slope[:, 0], slope[:, 1])[:, None]
        return np.asarray(position + left * np.asarray(t_m)[:, None])

    def project(self, xy_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance s and offset t to the left (N,) of positions (N, 2): the foot of the perpendicular.

        Beyond an end, s is the end's and t the distance with the side's sign.
        """
        s = self._knots_m[self._tree.query(xy_m)[1]]
        for _ in range(NEWTON_STEPS):
            offset, slope = xy_m - self._curve(s)[:, :2], self._slope(s)[:, :2]
            steps = np.einsum("ij,ij->i", offset, slope) / np.maximum(
                np.einsum("ij,ij->i", slope, slope) - np.einsum("ij,ij->i", offset, self._bend(s)[:, :2]), 0.1
            )
            s = np.clip(s + np.clip(steps, -self._spacing_m, self._spacing_m), self.start_m, self.end_m)
        offset, slope = xy_m - self._curve(s)[:, :2], self._slope(s)[:, :2]
        cross = slope[:, 0] * offset[:, 1] - slope[:, 1] * offset[:, 0]
        return s, np.where(cross >= 0, 1.0, -1.0) * np.hypot(offset[:, 0], offset[:, 1])


def straight(start_m: float, end_m: float, z_m: float = 0.0) -> Centreline:
    """A level line along x, s = x."""
    s = np.linspace(start_m, end_m, max(4, round((end_m - start_m) / 10)))
    return Centreline(s, np.stack([s, np.zeros_like(s), np.full_like(s, z_m)], axis=1))


def alignment(
    curvature_at: list[tuple[float, float]],
    height_at: list[tuple[float, float]],
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Centreline:
    """A line whose curvature is linear between (s, 1/m) pairs: straights, arcs, and clothoids between them.

    `height_at` are (s, z) pairs, joined without overshoot (PCHIP), z added to `start`'s frame. `start` is x, y and
    heading where the first pair's s lies. Beyond the given heights the line stays level.
    """
    knots, curvatures = (np.array(values, dtype=np.float64) for values in zip(*curvature_at, strict=True))
    count = max(4, math.ceil((knots[-1] - knots[0]) / SAMPLE_M) + 1)
    s = np.linspace(knots[0], knots[-1], count)
    # Four times finer than the knots, so that the integrals of a clothoid are exact to micrometres.
    fine = np.linspace(s[0], s[-1], 4 * (count - 1) + 1)
    heading = start[2] + _integral(fine, np.interp(fine, knots, curvatures))
    x, y = (start[i] + _integral(fine, f(heading)) for i, f in enumerate((np.cos, np.sin)))
    return Centreline(s, np.stack([x[::4], y[::4], _heights(s, height_at)], axis=1))


def _integral(s_m: FloatArray, values: FloatArray) -> FloatArray:
    """Running integral from the first position, by a spline through the values."""
    return np.asarray(CubicSpline(s_m, values).antiderivative()(s_m))


def _heights(s_m: FloatArray, height_at: list[tuple[float, float]]) -> FloatArray:
    knots, heights = (np.array(values, dtype=np.float64) for values in zip(*height_at, strict=True))
    if len(knots) < 2:
        return np.full_like(s_m, heights[0])
    return np.asarray(PchipInterpolator(knots, heights)(np.clip(s_m, knots[0], knots[-1])))
