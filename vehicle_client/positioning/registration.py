"""A sweep laid on the map by point-to-point ICP, as in KISS-ICP (Vizzo et al., IEEE RA-L 8(2), 2023, Sec. III-D).

The same steps as KISS-ICP 1.3, whose place in `KissICP` it takes, in a fifth of its time: a point whose nearest
neighbour was found is not searched for again until it has moved so far that another one could be nearer.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vehicle_client.frames import Matrix, Vector, apply, rigid
from vehicle_client.positioning.voxel_map import VoxelMap, Voxels, key_of, row_of

MOST_STEPS = 500
"""KISS-ICP's own default."""

SMALL_RAD = 1e-9
"""Below it a turn's series ends with its first term, to a double's last digit."""


class Registration:
    """Point-to-point ICP with Geman-McClure weights, until a step is smaller than `converged` (metres and radians)."""

    def __init__(self, converged: float) -> None:
        self._converged = converged

    def align_points_to_map(
        self,
        points: NDArray[np.float64],
        voxel_map: VoxelMap,
        initial_guess: Matrix,
        max_correspondance_distance: float,
        kernel: float,
    ) -> Matrix:
        """map_from_sensor (4, 4) of points (N, 3); the guess where nothing is to be aligned. By KISS-ICP's names.

        Not finite where the points do not say where the sensor is.
        """
        if voxel_map.empty():
            return initial_guess
        here = apply(initial_guess, points)
        gates = (max_correspondance_distance, kernel, self._converged)
        moved = _aligned(here, initial_guess[:3, 3].copy(), voxel_map.voxels, voxel_map.voxel_m, gates)
        found: Matrix = moved @ initial_guess
        if not np.isfinite(found).all():
            return found
        # Products of turns are no turns for ever.
        return rigid(Rotation.from_matrix(found[:3, :3]).as_matrix(), found[:3, 3])


@numba.njit(cache=True, nogil=True)
def _aligned(points: Matrix, centre: Vector, voxels: Voxels, voxel: float, gates: tuple[float, float, float]) -> Matrix:
    """The motion (4, 4) that lays the points (N, 3) about a centre (3,), which it moves, on the map (Eq. 10 to 13)."""
    farthest, kernel, converged = gates
    moved = np.eye(4)
    neighbours = np.full((len(points), 3), np.nan)
    searched = np.full((len(points), 3), np.nan)
    reaches = np.zeros((len(points), 2))
    for _ in range(MOST_STEPS):
        _find_neighbours(points, voxels, voxel, farthest, neighbours, searched, reaches)
        normal, moment = _linear_system(points, neighbours, centre, farthest, kernel)
        step = _about_origin(_solved(normal, moment), centre)
        turned = _motion(step)
        for i in range(len(points)):
            x, y, z = points[i]
            for k in range(3):
                points[i, k] = turned[k, 0] * x + turned[k, 1] * y + turned[k, 2] * z + turned[k, 3]
        moved = turned @ moved
        if not math.sqrt((step * step).sum()) >= converged:
            break
    return moved


@numba.njit(cache=True, nogil=True)
def _find_neighbours(
    points: Matrix,
    voxels: Voxels,
    voxel: float,
    farthest: float,
    neighbours: Matrix,
    searched: Matrix,
    reaches: Matrix,
) -> None:
    """Writes the nearest neighbour (N, 3) of each point that may be within `farthest`.

    `searched` (N, 3) is where a point was when its neighbour was searched for, `reaches` (N, 2) how far the nearest
    and any other one were then at least: after a move of d no other is nearer than that less d. The 27 voxels about a
    point hold all that is within a voxel's width.
    """
    for i in range(len(points)):
        moved = _distance(points[i], searched[i])
        if reaches[i, 0] - moved >= farthest or _distance(points[i], neighbours[i]) <= reaches[i, 1] - moved:
            continue
        neighbours[i] = np.nan
        nearest, other = _nearest(points[i], voxels, voxel, neighbours[i])
        searched[i] = points[i]
        reaches[i, 0], reaches[i, 1] = min(nearest, voxel), min(other, voxel)


@numba.njit(cache=True, nogil=True)
def _distance(a: Vector, b: Vector) -> float:
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return math.sqrt(x * x + y * y + z * z)


@numba.njit(cache=True, nogil=True)
def _nearest(point: Vector, voxels: Voxels, voxel: float, neighbour: Vector) -> tuple[float, float]:
    """Writes the nearest point in the 27 voxels about a point; its distance and that of the second nearest.

    Voxels that are farther than the second one are not looked at.
    """
    at = (math.floor(point[0] / voxel), math.floor(point[1] / voxel), math.floor(point[2] / voxel))
    first, second = np.inf, np.inf
    for dx in (0, -1, 1):
        away_x = _away(point[0], at[0], dx, voxel)
        for dy in (0, -1, 1):
            away_xy = away_x + _away(point[1], at[1], dy, voxel)
            for dz in (0, -1, 1):
                if away_xy + _away(point[2], at[2], dz, voxel) > second:
                    continue
                row = row_of(voxels, key_of(at[0] + dx, at[1] + dy, at[2] + dz))
                for k in range(voxels.number[row] if row >= 0 else 0):
                    held = voxels.points_m[row, k]
                    x, y, z = held[0] - point[0], held[1] - point[1], held[2] - point[2]
                    square = x * x + y * y + z * z
                    if square < first:
                        first, second = square, first
                        neighbour[0], neighbour[1], neighbour[2] = held[0], held[1], held[2]
                    elif square < second:
                        second = square
    return math.sqrt(first), math.sqrt(second)


@numba.njit(cache=True, nogil=True)
def _away(value: float, at: int, step: int, voxel: float) -> float:
    """Square of how far a point in the voxel `at` of one axis is from the next one before (-1) or after (1)."""
    if step == 0:
        return 0.0
    away = value - at * voxel if step < 0 else (at + 1) * voxel - value
    return away * away


@numba.njit(cache=True, nogil=True)
def _linear_system(
    points: Matrix, neighbours: Matrix, centre: Vector, farthest: float, kernel: float
) -> tuple[Matrix, Vector]:
    """Normal matrix (6, 6) and moment (6,) of the step (translation, turn about the centre) that takes points to their
    neighbours. About the map's origin, as KISS-ICP has it, a turn looks like a way when the car has gone far."""
    normal, moment = np.zeros((6, 6)), np.zeros(6)
    for i in range(len(points)):
        rx, ry, rz = points[i, 0] - neighbours[i, 0], points[i, 1] - neighbours[i, 1], points[i, 2] - neighbours[i, 2]
        square = rx * rx + ry * ry + rz * rz
        if not math.sqrt(square) < farthest:
            continue
        x, y, z = points[i, 0] - centre[0], points[i, 1] - centre[1], points[i, 2] - centre[2]
        w = kernel * kernel / ((kernel + square) * (kernel + square))
        # The rows of J are (I, -[p]x): its products, written out.
        normal[0, 0] += w
        normal[0, 4] += w * z
        normal[0, 5] -= w * y
        normal[1, 3] -= w * z
        normal[1, 5] += w * x
        normal[2, 3] += w * y
        normal[2, 4] -= w * x
        normal[3, 3] += w * (y * y + z * z)
        normal[3, 4] -= w * x * y
        normal[3, 5] -= w * x * z
        normal[4, 4] += w * (x * x + z * z)
        normal[4, 5] -= w * y * z
        normal[5, 5] += w * (x * x + y * y)
        moment[0] += w * rx
        moment[1] += w * ry
        moment[2] += w * rz
        moment[3] += w * (y * rz - z * ry)
        moment[4] += w * (z * rx - x * rz)
        moment[5] += w * (x * ry - y * rx)
    normal[1, 1] = normal[2, 2] = normal[0, 0]
    for row in range(6):
        for column in range(row):
            normal[row, column] = normal[column, row]
    return normal, moment


@numba.njit(cache=True, nogil=True)
def _solved(normal: Matrix, moment: Vector) -> Vector:
    """The step (6,), none where no point has a neighbour, and no number where they do not tell it."""
    if normal[0, 0] == 0.0:
        return np.zeros(6)
    if np.linalg.matrix_rank(normal) < 6:
        return np.full(6, np.nan)
    return np.asarray(-np.linalg.solve(normal, moment), dtype=np.float64)


@numba.njit(cache=True, nogil=True)
def _about_origin(step: Vector, centre: Vector) -> Vector:
    """The same step with its turn about the origin: its size is what KISS-ICP ends by."""
    same, turn = step.copy(), step[3:]
    same[0] -= turn[1] * centre[2] - turn[2] * centre[1]
    same[1] -= turn[2] * centre[0] - turn[0] * centre[2]
    same[2] -= turn[0] * centre[1] - turn[1] * centre[0]
    return same


@numba.njit(cache=True, nogil=True)
def _motion(step: Vector) -> Matrix:
    """(4, 4) of a step: the exponential of SE(3)."""
    turn = step[3:]
    angle = math.sqrt((turn * turn).sum())
    cross = np.array([[0.0, -turn[2], turn[1]], [turn[2], 0.0, -turn[0]], [-turn[1], turn[0], 0.0]])
    square = cross @ cross
    motion = np.eye(4)
    if angle < SMALL_RAD:
        motion[:3, :3] += cross
        motion[:3, 3] = step[:3]
        return motion
    sine, bent = math.sin(angle) / angle, 0.5 * (math.sin(0.5 * angle) / (0.5 * angle)) ** 2
    motion[:3, :3] += sine * cross + bent * square
    left = np.eye(3) + bent * cross + (1.0 - sine) / angle**2 * square
    motion[:3, 3] = left @ step[:3]
    return motion
