"""A hatchback: body and wheels as meshes, and where its glass begins; x forward, on z = 0."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from simulator.mesh import Mesh, cylinder, grid, joined, pose
from simulator.scene.mover import Model
from simulator.scene.scenery import Colour, Part, Surface

FloatArray = NDArray[np.float64]

AXLES_X_M = (-1.28, 1.32)
WHEEL_RADIUS_M = 0.31
HALF_TRACK_M = 0.77

# Side view and plan of a compact car, read off at stations along its 4.3 m.
_BELT = PchipInterpolator(
    [-2.15, -2.10, -1.75, -1.0, 0.7, 1.2, 1.9, 2.08, 2.15], [0.62, 0.90, 0.97, 0.95, 0.93, 0.89, 0.76, 0.66, 0.52]
)
_ROOF = PchipInterpolator(
    [-2.15, -2.05, -1.85, -1.55, -1.0, -0.1, 0.35, 1.15, 2.15], [0.0, 0.90, 1.14, 1.38, 1.46, 1.48, 1.41, 0.90, 0.0]
)
_BOTTOM = PchipInterpolator([-2.15, -1.8, 1.8, 2.15], [0.36, 0.22, 0.20, 0.28])
_HALF_WIDTH = PchipInterpolator([-2.15, -2.0, -1.4, 0.0, 1.4, 1.9, 2.15], [0.68, 0.82, 0.88, 0.89, 0.87, 0.80, 0.60])


def belt_height(x_m: FloatArray) -> FloatArray:
    """Height where the windows begin; over bonnet and boot, the body's top."""
    return np.asarray(_BELT(np.clip(x_m, -2.15, 2.15)))


def roof_height(x_m: FloatArray) -> FloatArray:
    """Height of the roof line, never below the belt."""
    return np.maximum(_ROOF(np.clip(x_m, -2.15, 2.15)), belt_height(x_m))


def half_width(x_m: FloatArray) -> FloatArray:
    """Half of the body's width."""
    return np.asarray(_HALF_WIDTH(np.clip(x_m, -2.15, 2.15)))


def body() -> Mesh:
    """The body's skin: cross-sections at stations along x."""
    x = np.sort(np.concatenate([np.linspace(-2.15, 2.15, 120), np.array([-2.149, 2.149])]))
    belt, roof, bottom, width = belt_height(x), roof_height(x), np.asarray(_BOTTOM(x)), half_width(x)
    cabin = np.clip((roof - belt) / 0.3, 0, 1)
    waist = (bottom + belt) / 2
    half = [
        (0.0 * width, bottom),
        (0.86 * width, bottom),
        (0.97 * width, bottom + 0.10),
        (1.00 * width, waist),
        (0.985 * width, belt - 0.06),
        (0.94 * width, belt),
        (0.89 * width, belt + 0.02),
        ((0.86 - 0.13 * cabin) * width, belt + 0.02 + np.maximum(roof - belt - 0.10, 0)),
        ((0.80 - 0.16 * cabin) * width, np.maximum(belt + 0.02, roof - 0.02)),
        ((0.40 - 0.05 * cabin) * width, np.maximum(belt + 0.03, roof + 0.01)),
        (0.0 * width, np.maximum(belt + 0.035, roof + 0.02)),
    ]
    y, z = np.stack([p[0] for p in half], 1), np.stack([p[1] for p in half], 1)
    ring_y, ring_z = np.concatenate([y, -y[:, -2::-1]], 1), np.concatenate([z, z[:, -2::-1]], 1)
    lattice = np.stack([np.broadcast_to(x[:, None], ring_y.shape), ring_y, ring_z], axis=-1)
    ends = [np.broadcast_to(lattice[i].mean(axis=0), lattice[i].shape) for i in (0, -1)]
    return grid(np.concatenate([ends[:1], lattice, ends[1:]]))


def wheels() -> Mesh:
    """Four wheels."""
    wheel = cylinder(WHEEL_RADIUS_M, 0.20, sides=32).moved(pose(0, 0.10, 0, roll_rad=np.pi / 2))
    return joined([wheel.moved(pose(x, y, WHEEL_RADIUS_M)) for x in AXLES_X_M for y in (-HALF_TRACK_M, HALF_TRACK_M)])


def model(colour: Colour) -> Model:
    """The car as something that moves."""
    parts = (Part(Surface.CAR, body(), colour=colour), Part(Surface.WHEEL, wheels(), colour=(0.02, 0.02, 0.02)))
    return Model(parts, middle_m=0.7, radius_m=2.4)
