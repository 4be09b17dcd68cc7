"""From points that deviate from the road to clusters of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.ndimage import label

from detector.arrays import FloatArray, IntArray
from detector.road.deviations import Deviations
from detector.road.ground import AHEAD_M, REACH_M

CELL_M = 0.25
# Beyond this range rings lie farther apart than a cell: cells grow with range so that neighbours stay neighbours.
COMPRESS_FROM_M = 12.0
MIN_POINTS = 2
MIN_FLAGGED_SHARE = 0.25
# One point counts for at most eight standard deviations.
MAX_POINT_SD = 8.0
# What is wider than this may be a hole and what lies beside it: the hole is deeper than a share of the depth of both,
# which is this percentile of its points'.
WIDE_M = 1.0
CORE_SHARE = 0.5
CORE_PERCENTILE = 90.0
# Behind this the car sees nothing that it did not see nearer before.
BEHIND_M = 12.0


@dataclass(frozen=True, slots=True)
class Cluster:
    """Points (indices into the arrays given) that deviate alike from the road, and how likely they are an obstacle."""

    indices: IntArray
    is_negative: bool
    confidence: float


def group(deviations: Deviations, candidates: np.ndarray, cell_m: float = CELL_M) -> list[IntArray]:
    """Indices of the connected clusters of at least two of the candidate points (mask (N,)).

    Only points in cells of which they are a good part count: among many hits on the road some deviate by chance.
    """
    if not candidates.any():
        return []
    cell, occupied, taken = _taken(deviations.along_m, deviations.across_m, deviations.range_m, candidates, cell_m)
    if taken.size < MIN_POINTS:
        return []
    components, _ = label(occupied, structure=np.ones((3, 3), dtype=np.int64))
    component = components.ravel()[cell]
    order = np.argsort(component, kind="stable")
    borders = np.flatnonzero(np.diff(component[order])) + 1
    return [members for members in np.split(taken[order], borders) if members.size >= MIN_POINTS]


def cores(deviations: Deviations, clusters: list[IntArray], cell_m: float = CELL_M) -> list[IntArray]:
    """Clusters of the deepest points of those that are wide: a gutter or a kerb's foot beside a hole is shallower."""
    deep = np.zeros(len(deviations.along_m), dtype=np.bool_)
    for members in clusters:
        depth = -deviations.residual_m[members]
        if max(np.ptp(deviations.along_m[members]), np.ptp(deviations.across_m[members])) > WIDE_M:
            deep[members[depth > CORE_SHARE * np.percentile(depth, CORE_PERCENTILE)]] = True
    return group(deviations, deep, cell_m) if deep.any() else []


@njit(cache=True, nogil=True)
def _taken(
    along: FloatArray, across: FloatArray, range_m: FloatArray, candidates: np.ndarray, cell_m: float
) -> tuple[IntArray, np.ndarray, IntArray]:
    """Cell and index of the candidates that are a good part of their cell's points, and the grid of cells that are
    occupied by them or beside them: cells that touch those next but one are one cluster.

    Cells grow with range, so that the grid is never larger than that of the strip.
    """
    shape = (int((BEHIND_M + AHEAD_M) / cell_m) + 4, int(2.0 * REACH_M / cell_m) + 4)
    cell = np.full(len(along), -1, dtype=np.int64)
    hits, marked = np.zeros(shape[0] * shape[1], dtype=np.int32), np.zeros(shape[0] * shape[1], dtype=np.int32)
    for i in range(len(along)):
        if along[i] <= -BEHIND_M:
            continue
        ratio = max(range_m[i] / COMPRESS_FROM_M, 1.0)
        scale = (1.0 + math.log(ratio)) / ratio / cell_m if ratio > 1.0 else 1.0 / cell_m
        row = int(along[i] * scale + BEHIND_M / cell_m) + 1
        column = int(across[i] * scale + REACH_M / cell_m) + 1
        if 0 < row < shape[0] - 1 and 0 < column < shape[1] - 1:
            cell[i] = row * shape[1] + column
            hits[cell[i]] += 1
            marked[cell[i]] += candidates[i]
    taken = np.flatnonzero(candidates)
    kept = np.zeros(len(taken), dtype=np.bool_)
    for n in range(len(taken)):
        c = cell[taken[n]]
        kept[n] = c >= 0 and marked[c] >= MIN_FLAGGED_SHARE * hits[c]
    taken = taken[kept]
    occupied = np.zeros(shape, dtype=np.bool_)
    for n in range(len(taken)):
        middle = divmod(cell[taken[n]], shape[1])
        occupied[middle[0] - 1 : middle[0] + 2, middle[1] - 1 : middle[1] + 2] = True
    return cell[taken], occupied, taken
