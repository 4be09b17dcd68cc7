"""The map that sweeps are laid on: points by voxel, as in KISS-ICP (Vizzo et al., IEEE RA-L 8(2), 2023, III-C)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from vehicle_client.frames import Matrix, Vector, apply

IntArray = NDArray[np.int64]

_AXIS_BITS = 21
"""Of a voxel's number along one axis, in its key: two voxels of one key are 2000 km apart."""

_SPREAD = 0x9E3779B97F4A7C15 - (1 << 64)
"""2^64 over the golden ratio, as a signed number: neighbouring keys come to lie far apart (Knuth, TAOCP 3, 6.4)."""

_FIRST_VOXELS = 1 << 14


class Voxels(NamedTuple):
    """Rows of voxels that are there, as compiled loops take them; `_free_row` finds one's row by its key.

    `key` and `number` (V,), `points_m` (V, K, 3) of which the first `number` are there, `row` (2^T,) by hash, -1 where
    there is none.
    """

    key: IntArray
    number: IntArray
    points_m: NDArray[np.float64]
    row: IntArray


class VoxelMap:
    """Points of a local map, at most `most_points` in a voxel of `voxel_m` and none near another, within `reach_m`.

    The same points in the same order make the same map as KISS-ICP 1.3, whose place in `KissICP` it takes.
    """

    def __init__(self, voxel_m: float, reach_m: float, most_points: int) -> None:
        self.voxel_m, self._reach_m, self._most_points = voxel_m, reach_m, most_points
        # As far apart as so many points lie when they fill the voxel's area.
        self._spacing_m = math.sqrt(voxel_m**2 / most_points)
        self._number = 0
        self._voxels = _empty(_FIRST_VOXELS, most_points)

    @property
    def voxels(self) -> Voxels:
        """What is in the map."""
        return self._voxels

    def empty(self) -> bool:
        """Whether it holds no point."""
        return self._number == 0

    def update(self, points_m: NDArray[np.float64], map_from_sensor: Matrix) -> None:
        """Add points (N, 3) of the sensor's frame, and forget what is out of its reach."""
        most = self._number + len(points_m)
        if most > len(self._voxels.key):
            self._voxels = _grown(self._voxels, self._number, most, self._most_points)
        here = apply(map_from_sensor, points_m)
        self._number = _add(self._voxels, self._number, here, self.voxel_m, self._spacing_m)
        self._number = _forget(self._voxels, self._number, map_from_sensor[:3, 3].copy(), self._reach_m)


def _empty(voxels: int, most_points: int) -> Voxels:
    number = np.zeros(voxels, dtype=np.int64)
    # Half of the hashes stay free at most: a search ends after one or two looks.
    row = np.full(1 << math.ceil(math.log2(2 * voxels)), -1, dtype=np.int64)
    return Voxels(number.copy(), number, np.empty((voxels, most_points, 3)), row)


def _grown(voxels: Voxels, number: int, least: int, most_points: int) -> Voxels:
    grown = _empty(max(least, 2 * len(voxels.key)), most_points)
    for old, new in zip(voxels[:3], grown[:3], strict=True):
        new[:number] = old[:number]
    _number_anew(grown, number)
    return grown


@numba.njit(cache=True, nogil=True)
def key_of(x: int, y: int, z: int) -> int:
    """Key of the voxel with these numbers along the axes."""
    mask = (1 << _AXIS_BITS) - 1
    return (x & mask) << 2 * _AXIS_BITS | (y & mask) << _AXIS_BITS | (z & mask)


@numba.njit(cache=True, nogil=True)
def _free_row(voxels: Voxels, key: int) -> int:
    """Where in `row` a voxel of this key stands, or would stand."""
    last = len(voxels.row) - 1
    at = ((key * _SPREAD) >> 20) & last
    while voxels.row[at] >= 0 and voxels.key[voxels.row[at]] != key:
        at = (at + 1) & last
    return at


@numba.njit(cache=True, nogil=True)
def row_of(voxels: Voxels, key: int) -> int:
    """Row of the voxel with this key, -1 where nothing is."""
    return int(voxels.row[_free_row(voxels, key)])


@numba.njit(cache=True, nogil=True)
def _number_anew(voxels: Voxels, number: int) -> None:
    voxels.row[:] = -1
    for i in range(number):
        voxels.row[_free_row(voxels, voxels.key[i])] = i


@numba.njit(cache=True, nogil=True)
def _add(voxels: Voxels, number: int, points: Matrix, voxel: float, spacing: float) -> int:
    """Adds what is not near another point of its voxel, as long as there is room; the number of voxels then."""
    for i in range(len(points)):
        x, y, z = points[i]
        key = key_of(math.floor(x / voxel), math.floor(y / voxel), math.floor(z / voxel))
        at = _free_row(voxels, key)
        row = voxels.row[at]
        if row < 0:
            row, number = number, number + 1
            voxels.row[at], voxels.key[row], voxels.number[row] = row, key, 0
        if _has_room(voxels.points_m[row], voxels.number[row], points[i], spacing):
            voxels.points_m[row, voxels.number[row]] = points[i]
            voxels.number[row] += 1
    return number


@numba.njit(cache=True, nogil=True)
def _has_room(held: Matrix, number: int, point: Vector, spacing: float) -> bool:
    if number == len(held):
        return False
    for k in range(number):
        dx, dy, dz = held[k, 0] - point[0], held[k, 1] - point[1], held[k, 2] - point[2]
        if math.sqrt(dx * dx + dy * dy + dz * dz) < spacing:
            return False
    return True


@numba.njit(cache=True, nogil=True)
def _forget(voxels: Voxels, number: int, place: Vector, reach: float) -> int:
    """Drops the voxels whose first point is out of reach; the number of those left."""
    kept = 0
    for row in range(number):
        first = voxels.points_m[row, 0]
        dx, dy, dz = first[0] - place[0], first[1] - place[1], first[2] - place[2]
        if dx * dx + dy * dy + dz * dz < reach * reach:
            if kept < row:
                voxels.key[kept], voxels.number[kept] = voxels.key[row], voxels.number[row]
                voxels.points_m[kept, : voxels.number[row]] = voxels.points_m[row, : voxels.number[row]]
            kept += 1
    if kept < number:
        _number_anew(voxels, kept)
    return kept
