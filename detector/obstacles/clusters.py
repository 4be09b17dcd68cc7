"""From points that deviate from the road to clusters of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from detector.arrays import IntArray
from detector.road.deviations import Deviations

MIN_POINTS = 2
MIN_FLAGGED_SHARE = 0.25
# One point counts for at most eight standard deviations.
MAX_POINT_SD = 8.0
# What is wider than this may be a hole and what lies beside it: the hole is deeper than a share of the depth of both,
# which is this percentile of its points'.
WIDE_M = 1.0
CORE_SHARE = 0.5
CORE_PERCENTILE = 90.0
# A cell that has no number yet.
OCCUPIED = -1


@dataclass(frozen=True, slots=True)
class Cluster:
    """Points (indices into the arrays given) that deviate alike from the road, and how likely they are an obstacle."""

    indices: IntArray
    is_negative: bool
    confidence: float


def group(deviations: Deviations, candidates: np.ndarray) -> list[IntArray]:
    """Indices of the connected clusters of at least two of the candidate points (mask (N,)).

    Only points in cells of which they are a good part count: among many hits on the road some deviate by chance.
    """
    if not candidates.any():
        return []
    cells = deviations.cells
    taken, component = _components(cells.cell, cells.hits, cells.shape, candidates)
    if taken.size < MIN_POINTS:
        return []
    order = np.argsort(component, kind="stable")
    borders = np.flatnonzero(np.diff(component[order])) + 1
    return [members for members in np.split(taken[order], borders) if members.size >= MIN_POINTS]


def cores(deviations: Deviations, clusters: list[IntArray]) -> list[IntArray]:
    """Clusters of the deepest points of those that are wide: a gutter or a kerb's foot beside a hole is shallower."""
    deep = np.zeros(len(deviations.along_m), dtype=np.bool_)
    for members in clusters:
        depth = -deviations.residual_m[members]
        if max(np.ptp(deviations.along_m[members]), np.ptp(deviations.across_m[members])) > WIDE_M:
            deep[members[depth > CORE_SHARE * np.percentile(depth, CORE_PERCENTILE)]] = True
    return group(deviations, deep) if deep.any() else []


@njit(cache=True, nogil=True)
def _components(
    cell: IntArray, hits: IntArray, shape: tuple[int, int], candidates: np.ndarray
) -> tuple[IntArray, IntArray]:
    """Index of the candidates that are a good part of their cell's points, and which connected component each is of.

    Cells that touch those next but one are one component; components count from 1, by rows of the grid.
    """
    taken = np.flatnonzero(candidates)
    marked = np.zeros(shape[0] * shape[1], dtype=np.int32)
    for i in taken:
        if cell[i] >= 0:
            marked[cell[i]] += 1
    kept = np.zeros(len(taken), dtype=np.bool_)
    component = np.zeros(shape, dtype=np.int32)
    for n in range(len(taken)):
        c = cell[taken[n]]
        kept[n] = c >= 0 and marked[c] >= MIN_FLAGGED_SHARE * hits[c]
        if kept[n]:
            row, column = divmod(c, shape[1])
            component[row - 1 : row + 2, column - 1 : column + 2] = OCCUPIED
    taken = taken[kept]
    number_components(component)
    return taken, component.ravel()[cell[taken]].astype(np.int64)


@njit(cache=True, nogil=True)
def number_components(component: np.ndarray) -> None:
    """Numbers the connected cells of a grid that are `OCCUPIED`, corners touching, from 1 in the order of its rows."""
    rows, columns = component.shape
    waiting, number = np.empty((rows * columns, 2), dtype=np.int32), 0
    for row in range(rows):
        for column in range(columns):
            if component[row, column] == OCCUPIED:
                number += 1
                _spread(component, row, column, number, waiting)


@njit(cache=True, nogil=True)
def _spread(component: np.ndarray, row: int, column: int, number: int, waiting: np.ndarray) -> None:
    """Gives a number to an occupied cell and all that are connected with it; `waiting` is room for their places."""
    rows, columns = component.shape
    component[row, column] = number
    waiting[0], last = (row, column), 0
    while last >= 0:
        i, j = waiting[last]
        last -= 1
        for k in range(max(i - 1, 0), min(i + 2, rows)):
            for m in range(max(j - 1, 0), min(j + 2, columns)):
                if component[k, m] == OCCUPIED:
                    component[k, m] = number
                    last += 1
                    waiting[last] = (k, m)
