"""The k nearest neighbours of every point of a cloud, exactly, leaf by leaf of a balanced kd-tree.

A cloud's neighbourhoods overlap, so the points of a leaf (about a dozen) share one search: all points nearer to their
box than the farthest neighbour of any of them are candidates for all. These are laid side by side in memory, so
distances and the search for the k-th smallest among them are loops over contiguous numbers, which compile to vector
instructions. No list is kept sorted: the k-th distance is found by counting.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from detector.arrays import Float32Array, FloatArray
from detector.errors import DetectorError
from detector.neighbours.closest import TINY, WORD, choose, kth_distance, squared_distances
from detector.neighbours.kd_tree import ZERO, RowArray, node_boxes, sort_into_leaves
from detector.threads import in_chunks

# Points of a leaf at most: the least time of 8, 16, 24 and 32 on a sweep of 114 thousand points.
LEAF_POINTS = 16
# Levels that are sorted before two threads share the rest.
TOP_LEVELS = 3
# A leaf's search begins with the squared reach of the last one, which lies beside it, and half of it more.
REACH_MARGIN = np.float32(1.5)
# Loops over candidates are compiled to 32 at a time: they end on points so far off that they are nobody's neighbours.
LANES = 32
FAR = np.float32(1e18)


@dataclass(frozen=True, slots=True)
class Neighbourhoods:
    """A cloud in an order in which neighbours lie near each other in memory.

    `points` (N, 3) are about the cloud's centre in units of its reach, so that float32 suffices; row i is point
    `order[i]` of the cloud; `nearest` (N, k) are the rows of its k nearest points, itself among them, in no order.
    """

    points: Float32Array
    order: RowArray
    nearest: RowArray


def find_neighbourhoods(points_m: FloatArray, count: int) -> Neighbourhoods:
    """The `count` nearest points of each of the points (N, 3), itself among them.

    Raises DetectorError for coordinates that are not finite and for fewer points than `count`.
    """
    if len(points_m) < count:
        raise DetectorError(f"{len(points_m)} points have no {count} nearest: a denser cloud is needed")
    records = _unit_records(points_m)
    n = len(records)
    depth = max(math.ceil(math.log2(n / LEAF_POINTS)), 0)
    top = min(depth, TOP_LEVELS)
    sort_into_leaves(records, 0, top, 0, 1)
    in_chunks(lambda start, stop: sort_into_leaves(records, top, depth, start, stop), 1 << top, n)
    points, order = np.ascontiguousarray(records[:, :3]), records.view(np.int32)[:, 3].copy()
    xyz, nearest = np.ascontiguousarray(points.T), np.empty((n, count), dtype=np.int32)
    boxes = node_boxes(xyz, depth)
    in_chunks(lambda start, stop: _search(xyz, boxes, depth, start, stop, nearest), 1 << depth, n)
    return Neighbourhoods(points, order, nearest)


def _unit_records(points_m: FloatArray) -> Float32Array:
    """Coordinates about the centre over the cloud's reach (N, 4); in the fourth place the bits of the row's number."""
    records = np.empty((len(points_m), 4), dtype=np.float32)
    records.view(np.int32)[:, 3] = np.arange(len(points_m))
    if not math.isfinite(_centre_and_scale(points_m, records)):
        raise DetectorError("the points are not all finite: leave out what is NaN or infinite")
    return records


@njit(cache=True, nogil=True)
def _centre_and_scale(points_m: FloatArray, records: Float32Array) -> float:
    """Fills the first three columns of the records; returns the cloud's reach, NaN or infinite if a coordinate is."""
    x = y = z = reach = 0.0
    for i in range(len(points_m)):
        x, y, z = x + points_m[i, 0], y + points_m[i, 1], z + points_m[i, 2]
    x, y, z = x / len(points_m), y / len(points_m), z / len(points_m)
    for i in range(len(points_m)):
        reach = max(reach, abs(points_m[i, 0] - x), abs(points_m[i, 1] - y), abs(points_m[i, 2] - z))
    unit = 1.0 / reach if reach > 0.0 else 1.0
    for i in range(len(points_m)):
        records[i, 0] = (points_m[i, 0] - x) * unit
        records[i, 1] = (points_m[i, 1] - y) * unit
        records[i, 2] = (points_m[i, 2] - z) * unit
    return reach + x + y + z


@njit(cache=True, nogil=True)
def _search(xyz: Float32Array, boxes: Float32Array, depth: int, start: int, stop: int, nearest: RowArray) -> None:
    """Fills the rows of `nearest` of the leaves [start, stop)."""
    n, count = nearest.shape
    ranges = np.empty((1 << depth, 2), np.int64)
    near, distances, rows, flags, chosen = _room(0)
    radii = np.empty((n >> depth) + 1, np.float32)
    reach = np.float32(np.inf)
    for leaf in range(start, stop):
        low, high = (n * leaf) >> depth, (n * (leaf + 1)) >> depth
        enough = _reach_of_enough(boxes, depth, n, leaf, count)
        reach, settled = min(reach, enough), ZERO
        radii[:] = np.inf
        while True:
            found, total = _leaves_within(boxes, depth, n, leaf, reach, count, ranges)
            if total + LANES > rows.size:
                near, distances, rows, flags, chosen = _room((2 * total + LANES) // WORD * WORD)
            total = _gather(xyz, ranges, found, boxes[(1 << depth) + leaf], reach, near, distances, rows)
            if total < count:
                reach = enough
                continue
            padded = (total + LANES - 1) // LANES * LANES
            _nearest_of_leaf(
                xyz, low, high, near, rows, padded, reach, settled, distances, flags, chosen, radii, nearest
            )
            farthest = radii[: high - low].max()
            if farthest <= reach:
                break
            # What lies farther than the reach was not looked at: once more for these rows, and then surely far enough.
            settled, reach = reach, np.float32(1.0001) * farthest
        reach = REACH_MARGIN * farthest


@njit(cache=True, nogil=True)
def _nearest_of_leaf(
    xyz: Float32Array,
    low: int,
    high: int,
    near: Float32Array,
    rows: RowArray,
    total: int,
    reach: np.float32,
    settled: np.float32,
    distances: Float32Array,
    flags: NDArray[np.uint8],
    chosen: RowArray,
    radii: Float32Array,
    nearest: RowArray,
) -> None:
    """Neighbours among `total` candidates of the leaf's rows [low, high) whose radius is beyond what is settled."""
    count = nearest.shape[1]
    guess = np.float32(0.5) * reach
    for row in range(low, high):
        if radii[row - low] > settled:
            guess = max(guess, TINY)
            x, y, z = xyz[0, row], xyz[1, row], xyz[2, row]
            within = squared_distances(near, total, x, y, z, distances, guess)
            below, guess = kth_distance(distances, total, count, guess, within)
            choose(distances, total, below, guess, count, rows, flags, chosen)
            for k in range(count):
                nearest[row, k] = chosen[k]
            radii[row - low] = guess


@njit(cache=True, nogil=True)
def _reach_of_enough(boxes: Float32Array, depth: int, n: int, leaf: int, count: int) -> np.float32:
    """Squared diagonal of the smallest node around a leaf that holds `count` points."""
    level, node = depth, leaf
    while level > 0 and ((n * (node + 1)) >> level) - ((n * node) >> level) < count:
        level, node = level - 1, node >> 1
    box = boxes[(1 << level) + node]
    diagonal = TINY
    for k in range(3):
        diagonal += (box[3 + k] - box[k]) ** 2
    return diagonal


@njit(cache=True, nogil=True)
def _room(size: int) -> tuple[Float32Array, Float32Array, RowArray, NDArray[np.uint8], RowArray]:
    return (
        np.empty((3, size), np.float32),
        np.empty(size, np.float32),
        np.empty(size, np.int32),
        np.empty(size, np.uint8),
        np.empty(size, np.int32),
    )


@njit(cache=True, nogil=True)
def _leaves_within(
    boxes: Float32Array, depth: int, n: int, leaf: int, reach: np.float32, count: int, ranges: NDArray[np.int64]
) -> tuple[int, int]:
    """Ranges of points whose leaves are nearer to `leaf` than the root of `reach`: their number, and that of points.

    Of leaves whose points all coincide with those of `leaf`, no more than hold `count` points.
    """
    leaves = 1 << depth
    own = boxes[leaves + leaf]
    waiting = np.empty(64, np.int64)
    waiting[0] = 1
    left, found, total, coinciding = 1, 0, 0, 0
    in_one_place = _is_in_one_place(own)
    while left > 0 and coinciding < count:
        left -= 1
        node = waiting[left]
        gap = ZERO
        for k in range(3):
            side = max(boxes[node, k] - own[3 + k], own[k] - boxes[node, 3 + k], ZERO)
            gap += side * side
        if gap > reach:
            continue
        if node < leaves:
            waiting[left], waiting[left + 1] = 2 * node + 1, 2 * node
            left += 2
            continue
        low, high = (n * (node - leaves)) >> depth, (n * (node - leaves + 1)) >> depth
        total += high - low
        if in_one_place and gap == ZERO and _is_in_one_place(boxes[node]):
            coinciding += high - low
        if found > 0 and ranges[found - 1, 1] == low:
            ranges[found - 1, 1] = high
        else:
            ranges[found, 0], ranges[found, 1] = low, high
            found += 1
    return found, total


@njit(cache=True, nogil=True)
def _is_in_one_place(box: Float32Array) -> bool:
    return bool(box[0] == box[3] and box[1] == box[4] and box[2] == box[5])


@njit(cache=True, nogil=True)
def _gather(
    xyz: Float32Array,
    ranges: NDArray[np.int64],
    found: int,
    box: Float32Array,
    reach: np.float32,
    near: Float32Array,
    distances: Float32Array,
    rows: RowArray,
) -> int:
    """The points of the ranges that lie within the root of `reach` of a box, to the front of `near`: how many.

    The ranges hold nearly twice as many; `distances` is room for them.
    """
    at = 0
    for k in range(found):
        low, high = ranges[k]
        _squared_gaps(xyz, low, high, box, distances)
        for i in range(low, high):
            rows[at] = i
            at += distances[i - low] <= reach
    for k in range(3):
        for i in range(at):
            near[k, i] = xyz[k, rows[i]]
    near[:, at : at + LANES] = FAR
    return at


@njit(cache=True, nogil=True, fastmath=True)
def _squared_gaps(xyz: Float32Array, low: int, high: int, box: Float32Array, gaps: Float32Array) -> None:
    """Squared distances of the rows [low, high) to a box; 0 in it."""
    for i in range(high - low):
        square = ZERO
        for k in range(3):
            x = xyz[k, low + i]
            gap = max(max(box[k] - x, x - box[3 + k]), ZERO)
            square += gap * gap
        gaps[i] = square
