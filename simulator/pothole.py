"""Shapes of the road itself, in metres over a local (x, y) grid: procedural potholes and bumps."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

GRID_STEP_M = 0.01
"""Half of the road mesh's finest step, so that the mesh and not the shape limits the detail."""


@dataclass(frozen=True, slots=True)
class Relief:
    """Height above (or, negative, below) the road around a centre, and the footprint that counts as obstacle.

    `heights_m` (rows y, columns x) and `footprint` (the same shape) are sampled every `step_m`, the centre in the
    middle; beyond the grid the road is undisturbed. `length_m` is the extent of the footprint along x, `width_m`
    along y.
    """

    heights_m: FloatArray
    footprint: BoolArray
    step_m: float

    @property
    def length_m(self) -> float:
        """Extent of the footprint along the local x."""
        return int(np.ptp(np.flatnonzero(self.footprint.any(axis=0))) + 1) * self.step_m

    @property
    def width_m(self) -> float:
        """Extent of the footprint along the local y."""
        return int(np.ptp(np.flatnonzero(self.footprint.any(axis=1))) + 1) * self.step_m

    @property
    def relief_m(self) -> float:
        """Greatest depth below or height above the road inside the footprint, never negative."""
        return float(np.abs(self.heights_m[self.footprint]).max())

    @property
    def footprint_area_m2(self) -> float:
        """Area of the footprint."""
        return float(np.count_nonzero(self.footprint)) * self.step_m**2

    @property
    def volume_m3(self) -> float:
        """Volume between the road and the surface inside the footprint, never negative."""
        return abs(float(self.heights_m[self.footprint].sum())) * self.step_m**2

    @property
    def reach_m(self) -> float:
        """Radius beyond which the road is undisturbed."""
        rows, columns = self.heights_m.shape
        return math.hypot(rows, columns) / 2 * self.step_m

    def height_at(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """Bilinear height at local positions, 0 beyond the grid."""
        heights: FloatArray = ndimage.map_coordinates(self.heights_m, self._indices(x_m, y_m), order=1, cval=0.0)
        return heights

    def covers(self, x_m: FloatArray, y_m: FloatArray) -> BoolArray:
        """Whether local positions lie inside the footprint."""
        inside: BoolArray = ndimage.map_coordinates(self.footprint, self._indices(x_m, y_m), order=0, cval=False)
        return inside

    def grown(self, area_factor: float) -> Relief:
        """The same shape with `area_factor` times the footprint's area and the same relief."""
        return replace(self, step_m=self.step_m * math.sqrt(area_factor))

    def _indices(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        rows, columns = self.heights_m.shape
        return np.stack([y_m / self.step_m + (rows - 1) / 2, x_m / self.step_m + (columns - 1) / 2])


def pothole(seed: int, length_m: float, width_m: float, depth_m: float, wall_m: float = 0.10) -> Relief:
    """Hole with an irregular outline, sloped walls `wall_m` wide, a rough floor and a slightly raised, broken rim."""
    rng = np.random.default_rng(seed)
    x_m, y_m = _grid(length_m, width_m, margin=1.45)
    rho = _outline_radius(rng, x_m, y_m, length_m, width_m)
    inside_m = (1 - rho) * math.sqrt(length_m * width_m) / 2
    wall = _smoothstep(inside_m / wall_m * (1 + 0.35 * _noise(rng, rho.shape, 0.12)))
    floor = 0.86 + 0.10 * _noise(rng, rho.shape, 0.15) + 0.05 * _noise(rng, rho.shape, 0.02)
    hole_m = wall * floor
    hole_m *= depth_m / hole_m.max()
    # Broken asphalt stands up to about a centimetre above the road within a hand's breadth of the edge.
    crest_m = 0.006 * np.exp(-(((inside_m + 0.03) / 0.03) ** 2)) * (1 + 0.7 * _noise(rng, rho.shape, 0.05))
    crest_m *= _smoothstep((1.4 - rho) / 0.3)
    return Relief(crest_m * (rho >= 1) - hole_m, rho < 1, GRID_STEP_M)


def bump(seed: int, length_m: float, width_m: float, height_m: float) -> Relief:
    """Smooth rise of the road itself, as over a tree's root."""
    rng = np.random.default_rng(seed)
    x_m, y_m = _grid(length_m, width_m, margin=1.1)
    rho = _outline_radius(rng, x_m, y_m, length_m, width_m)
    rise = _smoothstep((1 - rho) / 0.75) * (1 + 0.05 * _noise(rng, rho.shape, 0.10))
    return Relief(height_m * rise / rise.max(), rho < 1, GRID_STEP_M)


def _grid(length_m: float, width_m: float, margin: float) -> tuple[FloatArray, FloatArray]:
    half = [math.ceil(margin * side / 2 / GRID_STEP_M) * GRID_STEP_M for side in (length_m, width_m)]
    axes = [np.linspace(-h, h, round(2 * h / GRID_STEP_M) + 1) for h in half]
    x_m, y_m = np.meshgrid(*axes)
    return x_m, y_m


def _outline_radius(
    rng: np.random.Generator, x_m: FloatArray, y_m: FloatArray, length_m: float, width_m: float
) -> FloatArray:
    """1 on an irregular superellipse that just fills the box length x width about the origin, 0 in its middle."""
    angles = np.linspace(0, 2 * math.pi, 720, endpoint=False)
    exponent = rng.uniform(2.0, 2.8)
    harmonics = np.arange(2, 9)
    amplitudes = rng.normal(0, 0.07, harmonics.size) / np.sqrt(harmonics - 1)
    phases = rng.uniform(0, 2 * math.pi, harmonics.size)
    radii = (np.abs(np.cos(angles)) ** exponent + np.abs(np.sin(angles)) ** exponent) ** (-1 / exponent)
    radii *= 1 + (amplitudes[:, None] * np.cos(harmonics[:, None] * angles + phases[:, None])).sum(axis=0)
    outline = np.stack([radii * np.cos(angles), radii * np.sin(angles)])
    low, high = outline.min(axis=1), outline.max(axis=1)
    u = x_m / length_m * (high[0] - low[0]) + (high[0] + low[0]) / 2
    v = y_m / width_m * (high[1] - low[1]) + (high[1] + low[1]) / 2
    return np.asarray(np.hypot(u, v) / np.interp(np.arctan2(v, u), angles, radii, period=2 * math.pi))


def _noise(rng: np.random.Generator, shape: tuple[int, ...], wavelength_m: float) -> FloatArray:
    """Smooth noise of zero mean and unit standard deviation, clipped at two, with features of about `wavelength_m`."""
    noise = ndimage.gaussian_filter(rng.standard_normal(shape), wavelength_m / GRID_STEP_M / 4, mode="wrap")
    return np.asarray(np.clip((noise - noise.mean()) / noise.std(), -2, 2))


def _smoothstep(t: FloatArray) -> FloatArray:
    t = np.clip(t, 0, 1)
    return np.asarray(t * t * (3 - 2 * t))
