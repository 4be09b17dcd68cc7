"""Holes of a survey: seeds that the road's own waves do not explain, outlined and verified."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_opening, maximum_position

from detector.survey_grid import components_of, smooth
from detector.survey_outline import Outline, contour_families, outline_around, slope_of
from detector.survey_road import FINE_CELLS, Relief
from detector.types import FloatArray, IntArray

MaskArray = NDArray[np.bool_]

# Seeds stand out from the road's waves by this many standard deviations, over at least so many cells.
SEED_SD = 5.0
SEED_CELLS = 12
# What is reported is deep and steep: the product of its depth in standard deviations of the waves, and of its rim's
# slope in the road's own (median) slopes.
RECOGNISED_SD = 8.0
RECOGNISED_EVIDENCE = 48.0
# A hole narrower than this is texture.
MIN_AREA_M2 = 0.0007
# An outline never lies where the road's waves would.
OUTLINE_SD = 2.0
# A cell was not measured when so little of its smoothed neighbourhood was.
GAP_CERTAINTY = 0.35
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
    seeds, count = components_of(depth > SEED_SD * relief.wave_m)
    places = _places(depth, seeds, count, RECOGNISED_SD * relief.wave_m)
    if not places:
        return []
    slope = slope_of(depth, relief.grid.cell_m)
    road_slope = max(float(np.median(slope[occupied > 0.0])), 1e-6)
    gaps = binary_opening(certainty < GAP_CERTAINTY)
    families = contour_families(depth, slope, gaps, relief.grid.cell_m, OUTLINE_SD * relief.wave_m)
    taken = np.zeros(depth.shape, dtype=bool)
    holes = []
    for place in places:
        outline = None if taken[place] else outline_around(families, place, taken, float(occupied.sum()))
        if outline is None:
            continue
        taken[outline.extent] |= outline.mask
        measured = outline.mask & ~gaps[outline.extent]
        evidence = float(np.percentile(depth[outline.extent][measured], 95)) / relief.wave_m
        if (
            evidence >= RECOGNISED_SD
            and evidence * outline.slope / road_slope >= RECOGNISED_EVIDENCE
            and outline.mask.sum() * relief.grid.cell_m**2 >= MIN_AREA_M2
            and _border_share(outline, depth.shape) <= MAX_BORDER_SHARE
        ):
            holes.append(Hole(outline, evidence))
    return holes


def _places(depth: FloatArray, seeds: IntArray, count: int, least_m: float) -> list[tuple[int, int]]:
    """The deepest cell of each seed that is large and deep enough, deepest first."""
    numbers = np.arange(1, count + 1)
    large = numbers[np.bincount(seeds.ravel(), minlength=count + 1)[1:] >= SEED_CELLS]
    places = [(int(row), int(column)) for row, column in maximum_position(depth, seeds, large)]
    return sorted((place for place in places if depth[place] > least_m), key=lambda place: -depth[place])


def _border_share(outline: Outline, shape: tuple[int, ...]) -> float:
    """Share of an outline that lies on the border of the map."""
    padded = np.pad(outline.mask, 1)
    around = int((binary_dilation(padded) & ~padded).sum())
    on_border = 0
    for axis, extent in enumerate(outline.extent):
        lines = np.moveaxis(outline.mask, axis, 0)
        on_border += int(lines[0].sum()) * (extent.start == 0) + int(lines[-1].sum()) * (extent.stop == shape[axis])
    return on_border / max(around, 1)
