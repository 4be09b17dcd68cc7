"""A balanced kd-tree without pointers: points sorted so that each node is a stretch of them, and the nodes' boxes.

Node j of level l, of 2^l, holds the points from n j / 2^l to n (j + 1) / 2^l; the root is level 0, the leaves are the
last level. Whatever the density, outliers or points that coincide, the depth is the same.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from detector.arrays import Float32Array

RowArray = NDArray[np.int32]

ZERO = np.float32(0.0)


@njit(cache=True, nogil=True)
def sort_into_leaves(records: Float32Array, level: int, depth: int, start: int, stop: int) -> None:
    """Splits the nodes [start, stop) of a level at the median of their longest side, and so on down to `depth`.

    `records` (N, 4) are x, y, z and four bytes that go along.
    """
    n = len(records)
    for below in range(level, depth):
        for node in range(start << (below - level), stop << (below - level)):
            low, high = (n * node) >> below, (n * (node + 1)) >> below
            axis = _longest_side(records[low:high])
            if axis >= 0:
                _split(records, axis, low, high, (n * (2 * node + 1)) >> (below + 1))


@njit(cache=True, nogil=True, fastmath=True)
def _longest_side(records: Float32Array) -> int:
    """Axis along which records extend most, the first of equal ones; -1 where they are all in one place."""
    x_least, y_least, z_least, _ = records[0]
    x_most, y_most, z_most, _ = records[0]
    for i in range(1, len(records)):
        x, y, z = records[i, 0], records[i, 1], records[i, 2]
        x_least, x_most = min(x_least, x), max(x_most, x)
        y_least, y_most = min(y_least, y), max(y_most, y)
        z_least, z_most = min(z_least, z), max(z_most, z)
    longest, axis = ZERO, -1
    if x_most - x_least > longest:
        longest, axis = x_most - x_least, 0
    if y_most - y_least > longest:
        longest, axis = y_most - y_least, 1
    if z_most - z_least > longest:
        longest, axis = z_most - z_least, 2
    return axis


@njit(cache=True, nogil=True)
def _split(records: Float32Array, axis: int, low: int, high: int, middle: int) -> None:
    """Quickselect: afterwards no key of [low, middle) is greater than one of [middle, high)."""
    while high - low > 1:
        pivot = _median_of_nine(records, axis, low, high)
        border = _partition(records, axis, low, high, pivot, False)
        if border == low:
            # The pivot is the least: what equals it comes to the front instead.
            border = _partition(records, axis, low, high, pivot, True)
            if middle < border:
                return
        if middle < border:
            high = border
        else:
            low = border


@njit(cache=True, nogil=True)
def _partition(records: Float32Array, axis: int, low: int, high: int, pivot: float, with_equal: bool) -> int:
    """Keys less than the pivot, or equal to it, to the front; where they end. Without branches to mispredict."""
    border = low
    for i in range(low, high):
        key = records[i, axis]
        a, b, c, d = records[i, 0], records[i, 1], records[i, 2], records[i, 3]
        for k in range(4):
            records[i, k] = records[border, k]
        records[border, 0], records[border, 1], records[border, 2], records[border, 3] = a, b, c, d
        border += (key < pivot) | (with_equal & (key == pivot))
    return border


@njit(cache=True, nogil=True)
def _median_of_nine(records: Float32Array, axis: int, low: int, high: int) -> float:
    sample = np.empty(9, np.float32)
    for i in range(9):
        key = records[low + (high - low) * i // 9, axis]
        j = i
        while j > 0 and sample[j - 1] > key:
            sample[j] = sample[j - 1]
            j -= 1
        sample[j] = key
    return float(sample[4])


@njit(cache=True, nogil=True, fastmath=True)
def _extent(values: Float32Array, low: int, high: int) -> tuple[np.float32, np.float32]:
    least = most = values[low]
    for i in range(low, high):
        least, most = min(least, values[i]), max(most, values[i])
    return least, most


@njit(cache=True, nogil=True)
def node_boxes(xyz: Float32Array, depth: int) -> Float32Array:
    """Least and greatest coordinates (2^(depth + 1), 6) of all nodes: root 1, the children of k are 2k and 2k + 1."""
    n, leaves = xyz.shape[1], 1 << depth
    boxes = np.empty((2 * leaves, 6), np.float32)
    for leaf in range(leaves):
        low, high = (n * leaf) >> depth, (n * (leaf + 1)) >> depth
        for k in range(3):
            boxes[leaves + leaf, k], boxes[leaves + leaf, 3 + k] = _extent(xyz[k], low, high)
    for node in range(leaves - 1, 0, -1):
        for k in range(3):
            boxes[node, k] = min(boxes[2 * node, k], boxes[2 * node + 1, k])
            boxes[node, 3 + k] = max(boxes[2 * node, 3 + k], boxes[2 * node + 1, 3 + k])
    return boxes
