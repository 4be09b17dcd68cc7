"""Trees beside a road."""

from __future__ import annotations

import numpy as np

from simulator.mesh import Mesh, cylinder, pose
from simulator.scene.buildings import standing
from simulator.scene.ground import Clearance
from simulator.scene.scenery import Colour, Part, Surface
from simulator.streets.road import Road

TUFTS, TUFT_HALF_M = 3_000, 0.10
GREENS: tuple[Colour, ...] = ((0.11, 0.17, 0.04), (0.14, 0.19, 0.045), (0.085, 0.15, 0.045), (0.16, 0.18, 0.06))
BARK: Colour = (0.09, 0.065, 0.045)


def trees(
    road: Road,
    side: int,
    span_m: tuple[float, float],
    setback_m: tuple[float, float],
    clearance: Clearance,
    rng: np.random.Generator,
) -> list[Part]:
    """Trees between two distances from the edge, 9 to 22 m apart, where no road is in the way."""
    parts: list[Part] = []
    s = span_m[0]
    while s < span_m[1]:
        edge = float(road.half_width(np.array([s]))[0])
        place = standing(road, s, side * (edge + rng.uniform(*setback_m)), rng.uniform(0, 6))
        height, colour = rng.uniform(3.0, 4.6), GREENS[rng.integers(len(GREENS))]
        crown = _crown(rng, height)
        if float(clearance.at(place[None, :2, 3])[0][0]) > 0.3:
            trunk = cylinder(0.17, height + 0.6, 0.10, 10).moved(pose(0, 0, -0.6))
            parts.append(Part(Surface.TRUNK, trunk, place, BARK))
            parts.append(Part(Surface.TREE, crown, place, colour))
        s += rng.uniform(9, 22)
    return parts


def _crown(rng: np.random.Generator, trunk_m: float) -> Mesh:
    """Tufts of leaves, each a square turned at random, in several balls about the top of the trunk."""
    balls = np.stack([rng.normal(0, 0.8, 9), rng.normal(0, 0.8, 9), trunk_m + rng.uniform(-0.4, 1.7, 9)], axis=1)
    radii = rng.uniform(0.7, 1.3, 9)
    ball = rng.integers(0, 9, TUFTS)
    outwards = rng.standard_normal((TUFTS, 3))
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    centre = balls[ball] + outwards * (radii[ball] * rng.uniform(0.55, 1.0, TUFTS))[:, None]
    edges = rng.normal(0, TUFT_HALF_M, (2, TUFTS, 1, 3))
    corners = centre[:, None] + np.concatenate([-edges[0], edges[1], edges[0], -edges[1]], axis=1)
    triangles = 4 * np.repeat(np.arange(TUFTS), 2)[:, None] + np.tile([[0, 1, 2], [0, 2, 3]], (TUFTS, 1))
    return Mesh(corners.reshape(-1, 3), triangles)
