"""Pedestrians: a walking figure of rounded limbs, x forward, standing on z = 0."""

from __future__ import annotations

import math

import numpy as np

from simulator.mesh import Mesh, grid, joined, pose
from simulator.scene.mover import Model
from simulator.scene.scenery import Colour, Part, Surface

SKIN: Colour = (0.45, 0.27, 0.18)
CLOTHES: tuple[Colour, ...] = (
    (0.05, 0.06, 0.10),
    (0.25, 0.04, 0.04),
    (0.08, 0.14, 0.09),
    (0.45, 0.42, 0.36),
    (0.04, 0.04, 0.05),
    (0.10, 0.16, 0.30),
)
STRIDE_RAD = math.radians(22)
SIDES, RINGS = 10, 6


def pedestrian(seed: int) -> Model:
    """A person of 1.55 to 1.95 m in mid-stride."""
    rng = np.random.default_rng([seed, 7])
    size = rng.uniform(1.55, 1.95) / 1.75
    coat, trousers = (CLOTHES[i] for i in rng.permutation(len(CLOTHES))[:2])
    legs = joined(
        [_limb(0.06, 0.085, 0.88, (0, y, 0.90), swing) for y, swing in ((0.09, STRIDE_RAD), (-0.09, -STRIDE_RAD))]
    )
    arms = [_limb(0.04, 0.055, 0.62, (0, y, 1.42), swing) for y, swing in ((0.23, -STRIDE_RAD), (-0.23, STRIDE_RAD))]
    trunk = _ellipsoid(0.14, 0.22, 0.34).moved(pose(0, 0, 1.17))
    head = _ellipsoid(0.10, 0.085, 0.125).moved(pose(0.01, 0, 1.625))
    parts = [(joined([trunk, *arms]), coat), (legs, trousers), (head, SKIN)]
    scaled = tuple(Part(Surface.PEDESTRIAN, mesh.scaled(size, size, size), colour=colour) for mesh, colour in parts)
    return Model(scaled, middle_m=0.9 * size, radius_m=1.0 * size)


def _limb(
    thin_m: float, thick_m: float, length_m: float, joint_m: tuple[float, float, float], swing_rad: float
) -> Mesh:
    """A tapered ellipsoid that hangs from a joint, swung forward."""
    mesh = _ellipsoid((thin_m + thick_m) / 2, (thin_m + thick_m) / 2, length_m / 2).moved(pose(0, 0, -length_m / 2))
    return mesh.moved(pose(*joint_m, pitch_rad=-swing_rad))


def _ellipsoid(x_m: float, y_m: float, z_m: float) -> Mesh:
    azimuth = np.linspace(0, 2 * math.pi, SIDES + 1)
    polar = np.linspace(0, math.pi, RINGS + 1)[:, None]
    lattice = np.stack(
        [
            x_m * np.sin(polar) * np.cos(azimuth),
            y_m * np.sin(polar) * np.sin(azimuth),
            z_m * np.cos(polar) * np.ones_like(azimuth),
        ],
        axis=-1,
    )
    return grid(lattice)
