"""Irregular outlines and noise on a local grid: what potholes, bumps and repairs are drawn with."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from simulator.shapes.relief import GRID_STEP_M

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

ANGLES = 720
"""Directions in which an outline is sampled, half a degree apart."""

LOBE_DISTANCE = (0.60, 0.78)
"""Centres of neighbouring lobes, in units of the sum of their radii: they overlap, and a waist remains."""


def local_grid(length_m: float, width_m: float, margin: float) -> tuple[FloatArray, FloatArray]:
    """Positions x and y (rows, columns) every `GRID_STEP_M`, over `margin` times the box about the origin."""
    half = [math.ceil(margin * side / 2 / GRID_STEP_M) * GRID_STEP_M for side in (length_m, width_m)]
    axes = [np.linspace(-h, h, round(2 * h / GRID_STEP_M) + 1) for h in half]
    x_m, y_m = np.meshgrid(*axes)
    return x_m, y_m


def outline_radius(
    rng: np.random.Generator,
    x_m: FloatArray,
    y_m: FloatArray,
    length_m: float,
    width_m: float,
    roughness: float = 0.07,
    lobes: int = 1,
) -> FloatArray:
    """1 on an irregular outline that just fills the box length x width about the origin, 0 in its middle.

    `roughness` is the relative standard deviation of the radius's second harmonic; of several lobes, each an irregular
    superellipse, the outline is that of their union.
    """
    blobs = _row_of_blobs(rng, roughness, lobes)
    points = np.concatenate([blob.points() for blob in blobs])
    low, high = points.min(axis=0), points.max(axis=0)
    u = x_m / length_m * (high[0] - low[0]) + (high[0] + low[0]) / 2
    v = y_m / width_m * (high[1] - low[1]) + (high[1] + low[1]) / 2
    return np.asarray(np.min([blob.radius(u, v) for blob in blobs], axis=0))


def noise(rng: np.random.Generator, shape: tuple[int, ...], wavelength_m: float) -> FloatArray:
    """Smooth noise of zero mean and unit standard deviation, clipped at two, with features of about `wavelength_m`."""
    smooth = ndimage.gaussian_filter(rng.standard_normal(shape), wavelength_m / GRID_STEP_M / 4, mode="wrap")
    return np.asarray(np.clip((smooth - smooth.mean()) / smooth.std(), -2, 2))


def smoothstep(t: FloatArray) -> FloatArray:
    """0 below 0, 1 above 1, and a smooth rise between."""
    t = np.clip(t, 0, 1)
    return np.asarray(t * t * (3 - 2 * t))


def one_piece(inside: BoolArray) -> BoolArray:
    """The largest connected piece of a plan, its islands filled."""
    pieces, count = ndimage.label(inside)
    if count > 1:
        inside = pieces == 1 + np.argmax(np.bincount(pieces.ravel())[1:])
    filled: BoolArray = ndimage.binary_fill_holes(inside)
    return filled


@dataclass(frozen=True, slots=True)
class _Blob:
    """A superellipse with wobbling `radii` (ANGLES,) about a centre, `size` times as large."""

    radii: FloatArray
    centre: FloatArray
    size: float

    def points(self) -> FloatArray:
        angles = np.linspace(0, 2 * math.pi, ANGLES, endpoint=False)
        directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        return np.asarray(self.centre + self.size * self.radii[:, None] * directions)

    def radius(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """1 on the outline, falling by 1 over a unit of length, so that small lobes are shallow ones."""
        du, dv = u - self.centre[0], v - self.centre[1]
        angles = np.linspace(0, 2 * math.pi, ANGLES, endpoint=False)
        own = np.hypot(du, dv) / np.interp(np.arctan2(dv, du), angles, self.size * self.radii, period=2 * math.pi)
        return np.asarray(1 - self.size * (1 - own))


def _row_of_blobs(rng: np.random.Generator, roughness: float, count: int) -> list[_Blob]:
    blobs = [_Blob(_wobbling_radii(rng, roughness), np.zeros(2), 1.0)]
    for _ in range(count - 1):
        last, size = blobs[-1], rng.uniform(0.55, 0.95)
        direction = rng.normal(0, 0.6)
        distance = rng.uniform(*LOBE_DISTANCE) * (last.size + size)
        centre = last.centre + distance * np.array([math.cos(direction), math.sin(direction)])
        blobs.append(_Blob(_wobbling_radii(rng, roughness), centre, size))
    return blobs


def _wobbling_radii(rng: np.random.Generator, roughness: float) -> FloatArray:
    angles = np.linspace(0, 2 * math.pi, ANGLES, endpoint=False)
    exponent = rng.uniform(2.0, 2.8)
    harmonics = np.arange(2, 9)
    amplitudes = rng.normal(0, roughness, harmonics.size) / np.sqrt(harmonics - 1)
    phases = rng.uniform(0, 2 * math.pi, harmonics.size)
    radii = (np.abs(np.cos(angles)) ** exponent + np.abs(np.sin(angles)) ** exponent) ** (-1 / exponent)
    wobble = (amplitudes[:, None] * np.cos(harmonics[:, None] * angles + phases[:, None])).sum(axis=0)
    return np.asarray(radii * np.maximum(1 + wobble, 0.5))
