"""Holes of a survey: seeds that the road's own waves do not explain, outlined and verified."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_opening, find_objects, maximum

from detector.arrays import FloatArray
from detector.survey.grid import components_of, smooth
from detector.survey.outline import Outline, contour_families, depth_nearby, outline_of, slope_of
from detector.survey.road import FINE_CELLS, Relief

MaskArray = NDArray[np.bool_]

# Seeds stand out from the road's waves by this many standard deviations, over at least so many cells.
SEED_SD = 5.0
SEED_CELLS = 12
# What is reported is deep and steep: the product of its depth in standard deviations of the waves, and of its rim's
# slope in the road's own (median) slopes.
RECOGNISED_SD = 8.0
RECOGNISED_EVIDENCE = 53.0
# What an outline leaves of its seed is a basin of its own from this share of the depth nearby; else it is apron.
BASIN_SHARE = 0.5
# Texture is up to 3 cm across: what is smaller must stand out in inverse proportion to its area.
TEXTURE_AREA_M2 = 0.0007
# An outline never lies where the road's waves would.
OUTLINE_SD = 2.0
# A cell was not measured when so little of its smoothed neighbourhood was.
GAP_CERTAINTY = 0.35
# Where so much of what surrounds a gap is deep, the wall of a hole hides what lies there.
HIDDEN_SHARE = 0.25
# Of a hole, road is seen on most sides; a corner that merely falls away is no hole.
MAX_BORDER_SHARE = 0.35


@dataclass(frozen=True, slots=True)
class Hole:
    """One outlined hole, and its depth in standard deviations of the road's waves."""

    outline: Outline
    evidence_sd: float


def find_holes(relief: Relief) -> list[Hole]:
    """Holes of a relief, deepest first; where its depths are heights, what rises."""
    occupied = (relief.count > 0).astype(np.float64)
    depth, certainty = smooth(relief.depth_map_m, occupied, FINE_CELLS)
    least_m = RECOGNISED_SD * relief.wave_m
    seeds = _seeds(depth, depth > SEED_SD * relief.wave_m, least_m)
    if not seeds:
        return []
    slope = slope_of(depth, relief.grid.cell_m)
    road_slope = max(float(np.median(slope[occupied > 0.0])), 1e-6)
    unmeasured = binary_opening(certainty < GAP_CERTAINTY)
    gaps = _hidden(unmeasured, depth > SEED_SD * relief.wave_m)
    cell_m = relief.grid.cell_m
    nearby = depth_nearby(depth, cell_m)
    families = contour_families(depth, nearby, slope, gaps, cell_m, OUTLINE_SD * relief.wave_m)
    # Cells that no further seed may begin with.
    taken = depth < BASIN_SHARE * nearby
    holes = []
    while seeds:
        seed = seeds.pop(0)
        outline = outline_of(families, seed, float(occupied.sum()))
        if outline is None:
            continue
        taken[outline.extent] |= outline.mask
        for family in families:
            family.take(outline)
        seeds += _rest(seed, taken, depth, least_m)
        measured = outline.mask & ~gaps[outline.extent]
        evidence = float(np.percentile(depth[outline.extent][measured], 95)) / relief.wave_m
        if (
            evidence >= RECOGNISED_SD
            and evidence * outline.slope / road_slope >= _least_evidence(outline, cell_m)
            and _border_share(outline, unmeasured & ~gaps) <= MAX_BORDER_SHARE
        ):
            holes.append(Hole(outline, evidence))
    return holes


def _least_evidence(outline: Outline, cell_m: float) -> float:
    area_m2 = float(outline.mask.sum()) * cell_m**2
    return RECOGNISED_EVIDENCE * max(TEXTURE_AREA_M2 / area_m2, 1.0)


def _seeds(depth: FloatArray, deep: MaskArray, least_m: float) -> list[Outline]:
    """Connected regions of a mask that are large and deep enough to begin with, deepest first."""
    numbers, count = components_of(deep)
    if count == 0:
        return []
    cells = np.bincount(numbers.ravel(), minlength=count + 1)
    deepest = np.asarray(maximum(depth, numbers, np.arange(count + 1)))
    extents = [(rows, columns) for rows, columns in find_objects(numbers)]
    chosen = [n for n in range(1, count + 1) if cells[n] >= SEED_CELLS and deepest[n] > least_m]
    chosen.sort(key=lambda n: -deepest[n])
    return [Outline(extents[n - 1], numbers[extents[n - 1]] == n, 0.0) for n in chosen]


def _rest(seed: Outline, taken: MaskArray, depth: FloatArray, least_m: float) -> list[Outline]:
    """What an outline left of its seed, where that is deep enough to begin with and not taken."""
    rows, columns = seed.extent
    rest = _seeds(depth[seed.extent], seed.mask & ~taken[seed.extent], least_m)
    return [
        Outline(
            (
                slice(rows.start + part.extent[0].start, rows.start + part.extent[0].stop),
                slice(columns.start + part.extent[1].start, columns.start + part.extent[1].stop),
            ),
            part.mask,
            0.0,
        )
        for part in rest
    ]


def _hidden(gaps: MaskArray, deep: MaskArray) -> MaskArray:
    """The gaps (R, C) that a hole can hide: inside the survey, with much depth around them."""
    numbers, count = components_of(gaps)
    around, below = np.zeros(count + 1), np.zeros(count + 1)
    padded = np.pad(numbers, 1)
    for rows, columns in ((0, 1), (2, 1), (1, 0), (1, 2)):
        beside = padded[rows : rows + gaps.shape[0], columns : columns + gaps.shape[1]]
        touching = (beside > 0) & ~gaps
        around += np.bincount(beside[touching], minlength=count + 1)
        below += np.bincount(beside[touching & deep], minlength=count + 1)
    hidden = below >= HIDDEN_SHARE * np.maximum(around, 1.0)
    hidden[0] = False
    for line in (numbers[0], numbers[-1], numbers[:, 0], numbers[:, -1]):
        hidden[line] = False
    return np.asarray(hidden[numbers])


def _border_share(outline: Outline, outside: MaskArray) -> float:
    """Share of what surrounds an outline that lies outside the survey: on the cells (R, C) named, or off the map."""
    rows, columns = outline.extent
    beyond = np.pad(outside, 1, constant_values=True)[rows.start : rows.stop + 2, columns.start : columns.stop + 2]
    inside = np.pad(outline.mask, 1)
    around = binary_dilation(inside) & ~inside
    return float(beyond[around].mean())
