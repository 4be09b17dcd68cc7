"""The k closest of some candidates laid side by side in memory: distances, the k-th of them, and who is within it.

No list is kept sorted: the k-th distance is found by counting, in loops that compile to vector instructions. `total` is
a multiple of their lanes.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from detector.arrays import Float32Array
from detector.neighbours.kd_tree import ZERO, RowArray

# Where distances are equal no limit holds exactly k of them: the search ends here.
MAX_STEPS = 40
TINY = np.float32(1e-14)
# Flags of candidates are looked at eight at a time: where the closest ones are together, most words have none.
WORD = 8


@njit(cache=True, nogil=True, fastmath=True)
def squared_distances(
    near: Float32Array,
    total: int,
    x: np.float32,
    y: np.float32,
    z: np.float32,
    distances: Float32Array,
    limit: np.float32,
) -> int:
    """Fills the squared distances from a place; how many are within the limit."""
    # Counted in float32, exact to 2^24: eight at a time.
    within = ZERO
    for i in range(total):
        a, b, c = near[0, i] - x, near[1, i] - y, near[2, i] - z
        square = a * a + b * b + c * c
        distances[i] = square
        within += np.float32(1.0) if square <= limit else ZERO
    return int(within)


@njit(cache=True, nogil=True, fastmath=True)
def _count_within(distances: Float32Array, total: int, limit: np.float32) -> int:
    within = ZERO
    for i in range(total):
        within += np.float32(1.0) if distances[i] <= limit else ZERO
    return int(within)


@njit(cache=True, nogil=True)
def kth_distance(
    distances: Float32Array, total: int, count: int, guess: np.float32, within: int
) -> tuple[np.float32, np.float32]:
    """The k-th distance between two limits: fewer than `count` distances are within the first, `count` in the second.

    `within` is how many are within the guess. More are within the second only where they are equal. Regula falsi on
    counts: on a surface the number of points within a squared distance grows in proportion to it.
    """
    low, least = np.float32(-1.0), 0
    high, most = guess, within
    while most < count:
        low, least = high, most
        high *= np.float32(2.0)
        most = _count_within(distances, total, high)
    for step in range(MAX_STEPS):
        if most == count:
            break
        share = np.float32(0.5) if step % 3 == 2 else np.float32((count - least + 0.5) / (most - least + 0.5))
        middle = max(low, ZERO) + share * (high - max(low, ZERO))
        if middle <= low or middle >= high:
            break
        within = _count_within(distances, total, middle)
        if within >= count:
            high, most = middle, within
        else:
            low, least = middle, within
    return low, high


@njit(cache=True, nogil=True)
def choose(
    distances: Float32Array,
    total: int,
    below: np.float32,
    limit: np.float32,
    count: int,
    rows: RowArray,
    flags: NDArray[np.uint8],
    chosen: RowArray,
) -> None:
    """The `count` candidates within the limit to the front of `chosen`; of equally distant ones the first.

    Fewer than `count` lie within `below`; where too many lie within the limit, those between are equally distant.
    """
    at = _within(distances, total, limit, rows, flags, chosen)
    if at > count:
        at = 0
        for i in range(total):
            if distances[i] <= below:
                chosen[at] = rows[i]
                at += 1
        for i in range(total):
            if below < distances[i] <= limit and at < count:
                chosen[at] = rows[i]
                at += 1


@njit(cache=True, nogil=True)
def _within(
    distances: Float32Array,
    total: int,
    limit: np.float32,
    rows: RowArray,
    flags: NDArray[np.uint8],
    chosen: RowArray,
) -> int:
    """The candidates within the limit to the front of `chosen`, in their order: how many."""
    words = flags.view(np.uint64)
    for i in range(total):
        flags[i] = distances[i] <= limit
    # Indices without a sign are not looked at for counting from the end.
    at = np.uint64(0)
    for word in range(np.uint64(total // WORD)):
        if words[word] != 0:
            for k in range(np.uint64(WORD)):
                chosen[at] = rows[np.uint64(WORD) * word + k]
                at += np.uint64(flags[np.uint64(WORD) * word + k])
    return int(at)
