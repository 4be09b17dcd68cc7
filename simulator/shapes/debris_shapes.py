"""Meshes of what falls off lorries and cars, at about their real size, in any position: `debris` fits them to a box."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from simulator.mesh import Mesh, box, cylinder, grid, joined, pose

FloatArray = NDArray[np.float64]

ROCK_POINTS = 90


def pallet(rng: np.random.Generator) -> Mesh:
    """Half a wooden pallet that came down on a block: boards on three bearers, one side raised, one board loose."""
    bearers = [box(1.0, 0.09, 0.10).moved(pose(0, y, 0)) for y in (-0.38, 0.0, 0.38)]
    xs = np.linspace(-0.43, 0.43, 6) + rng.normal(0, 0.01, 6)
    boards = [box(0.11, 0.86, 0.022).moved(pose(x, 0, 0.10, rng.normal(0, 0.02))) for x in xs]
    loose = box(0.10, 0.62, 0.02).moved(pose(0.12, -0.05, 0.16, rng.uniform(0.5, 0.9), roll_rad=0.12))
    block = box(0.20, 0.20, 0.14).moved(pose(-0.33, 0.20, 0.0, 0.3))
    # Its front edge, at x = 0.5, stays on the road.
    raised = joined([*bearers, *boards, loose]).moved(pose(0, 0, 0.5 * math.sin(0.16), pitch_rad=0.16))
    return joined([raised, block])


def tyre(rng: np.random.Generator) -> Mesh:
    """A car's tyre on its side: an outer wall, two bulging flanks and the open inside, 63 cm across."""
    wear = rng.uniform(0.0, 0.008)
    outer, inner, half = 0.315 - wear, 0.20, 0.10
    section = [(inner, -half * 0.8), (0.26, -half), (outer - 0.02, -half * 0.85), (outer, -half * 0.5)]
    section += [(radius, -z) for radius, z in reversed(section)]
    section += [(inner + 0.01, half * 0.6), (outer - 0.03, half * 0.4), (outer - 0.03, -half * 0.4)]
    section += [(inner + 0.01, -half * 0.6), section[0]]
    return _revolved(np.array(section), sides=36)


def tread(rng: np.random.Generator) -> Mesh:
    """The tread that a lorry's retreaded tyre threw off: a curled, torn strip of rubber and steel cord."""
    stations, across = 28, 7
    s, t = np.linspace(0, 1, stations), np.linspace(-1, 1, across)
    # It keeps some of the tyre's curvature, more at one end.
    angle = np.cumsum(rng.uniform(0.9, 1.5) * np.linspace(0.1, 2.0, stations) / stations)
    x, z = np.cumsum(np.cos(angle)) / stations, np.cumsum(np.sin(angle)) / stations
    torn = 1 + 0.25 * rng.standard_normal((stations, 2)).cumsum(axis=0) / math.sqrt(stations)
    half_width = 0.12 * np.where(t[None, :] < 0, torn[:, :1], torn[:, 1:])
    twist = rng.uniform(-0.5, 0.5) * s[:, None]
    y = half_width * t * np.cos(twist)
    height = 0.45 * z[:, None] + half_width * t * np.sin(twist) + 0.02 * (1 - t**2)
    top = np.stack([np.broadcast_to(1.5 * x[:, None], y.shape), y, height], axis=-1)
    return _thickened(top, 0.022)


def carton(rng: np.random.Generator) -> Mesh:
    """A cardboard or wooden box, dented, two flaps of its lid open."""
    length, width, height = 0.6, 0.4, 0.35
    body = box(length, width, height)
    dents = rng.normal(0, 0.012, body.vertices_m.shape) * (body.vertices_m[:, 2:] > 0)
    flaps = []
    for side in (-1, 1):
        lean = side * rng.uniform(0.3, 1.1)
        flaps.append(box(length * 0.97, width * 0.45, 0.006).moved(pose(0, side * width / 2, height, 0.0, 0.0, lean)))
    return joined([Mesh(body.vertices_m + dents, body.triangles), *flaps])


def rock(rng: np.random.Generator) -> Mesh:
    """One broken rock: the hull of points about an ellipsoid, cut by a few fresh faces."""
    points = rng.standard_normal((ROCK_POINTS, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points *= rng.uniform(0.90, 1.0, (ROCK_POINTS, 1))
    for normal in _unit_vectors(rng, 5):
        over = np.maximum(points @ normal - rng.uniform(0.55, 0.8), 0)
        points -= over[:, None] * normal
    return _hull(points * np.array([0.5, rng.uniform(0.33, 0.48), rng.uniform(0.25, 0.4)]))


def rocks(rng: np.random.Generator) -> Mesh:
    """A lorry's spill: one rock and several smaller ones around it."""
    stones = [rock(rng)]
    for angle in np.linspace(0, 2 * math.pi, int(rng.integers(4, 8)), endpoint=False) + rng.uniform(0, 1):
        size, distance = rng.uniform(0.2, 0.55), rng.uniform(0.6, 1.0)
        stone = rock(rng).scaled(size, size, size)
        low = float(stone.vertices_m[:, 2].min())
        stones.append(stone.moved(pose(distance * math.cos(angle), distance * math.sin(angle), -low, angle)))
    first = stones[0]
    stones[0] = first.moved(pose(0, 0, -float(first.vertices_m[:, 2].min())))
    return joined(stones)


def timber(rng: np.random.Generator) -> Mesh:
    """A squared beam with split ends, resting on a board of the same load."""
    sides = 4
    xs = np.array([-1.2, -1.14, -0.6, 0.6, 1.15, 1.2])
    angles = np.linspace(0, 2 * math.pi, sides + 1) + math.pi / 4
    lattice = np.zeros((len(xs), sides + 1, 3))
    lattice[..., 0] = xs[:, None]
    lattice[..., 1], lattice[..., 2] = 0.085 * np.cos(angles), 0.085 * np.sin(angles)
    split = rng.uniform(-0.08, 0.08, (2, sides))
    lattice[0, :, 0] += np.append(split[0], split[0, 0])
    lattice[-1, :, 0] += np.append(split[1], split[1, 0])
    beam = joined([grid(lattice), *_caps(lattice)])
    board = box(0.9, 0.14, 0.025).moved(pose(rng.uniform(-0.4, 0.4), 0.02, -0.085, rng.uniform(0.15, 0.4)))
    return joined([beam.moved(pose(0, 0, 0.0, 0.0, rng.uniform(0.0, 0.02))), board])


def exhaust(rng: np.random.Generator) -> Mesh:
    """A muffler with a bent length of pipe at each end."""
    muffler = cylinder(0.5, 1.0, sides=24).scaled(0.20, 0.26, 0.45).moved(pose(-0.225, 0, 0.0, pitch_rad=math.pi / 2))
    bend = rng.uniform(0.15, 0.5)
    front, back = rng.uniform(0.5, 0.75), rng.uniform(0.12, 0.2)
    along = pose(0.22, 0.05, 0.0, 0.0, math.pi / 2)
    bent = pose(0.21 + front * 0.6, 0.05, 0.0, bend, math.pi / 2)
    pipes = [
        cylinder(0.028, front * 0.6, sides=12).moved(along),
        cylinder(0.028, front, sides=12).moved(bent),
        cylinder(0.030, back, sides=12).moved(pose(-0.22 - back, -0.05, 0.0, 0.0, math.pi / 2)),
    ]
    return joined([muffler, *pipes])


def cone(rng: np.random.Generator) -> Mesh:
    """A traffic cone of 75 cm on its side: the corner of its base and its tip touch the road."""
    height, base = 0.75, 0.40
    body = cylinder(0.14, height, 0.028, 20)
    upright = joined([body, box(base, base, 0.04)]).moved(pose(0, 0, 0, rng.uniform(-0.2, 0.2)))
    lean = math.pi / 2 + math.atan2(base / 2 - 0.03, height)
    return upright.moved(pose(0, 0, 0, 0.0, lean))


def _revolved(section_rz: FloatArray, sides: int) -> Mesh:
    """Section (P, 2) of (radius, z) turned about the z axis."""
    angles = np.linspace(0, 2 * math.pi, sides + 1)
    radius, z = section_rz.T
    lattice = np.stack(
        [
            radius[:, None] * np.cos(angles),
            radius[:, None] * np.sin(angles),
            np.broadcast_to(z[:, None], (len(z), sides + 1)),
        ],
        axis=-1,
    )
    return grid(lattice)


def _thickened(top_m: FloatArray, thickness_m: float) -> Mesh:
    """A sheet (rows, columns, 3) as a plate with closed edges."""
    bottom = top_m - np.array([0, 0, thickness_m])
    sides = [(top_m[:, 0], bottom[:, 0]), (top_m[:, -1], bottom[:, -1]), (top_m[0], bottom[0]), (top_m[-1], bottom[-1])]
    return joined([grid(top_m), grid(bottom), *(grid(np.stack(side)) for side in sides)])


def _caps(lattice_m: FloatArray) -> list[Mesh]:
    """The two ends of a beam whose sections are rings of four corners and the first again."""
    return [grid(np.stack([ring[[0, 1]], ring[[3, 2]]])) for ring in (lattice_m[0], lattice_m[-1])]


def _hull(points: FloatArray) -> Mesh:
    hull = ConvexHull(points)
    return Mesh(points, hull.simplices.astype(np.int64))


def _unit_vectors(rng: np.random.Generator, count: int) -> FloatArray:
    vectors = rng.standard_normal((count, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
