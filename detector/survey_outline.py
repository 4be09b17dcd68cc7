"""Outlines of holes in a map of depth: of all levels, the one whose contour is steepest.

A blurred step is steepest where the step is, whatever the blur; a worn apron is flatter than the broken edge inside it.
Levels are shares of the depth nearby and not of the whole hole's, so that a shallow bay keeps its own rim beside a
deep core.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects, gaussian_filter, grey_dilation, label, sobel

from detector.types import FloatArray, IntArray

MaskArray = NDArray[np.bool_]

# Shares of the depth nearby among which the steepest contour is sought.
SHARES = np.arange(0.05, 0.81, 0.05)
# A bay wider than a tyre is part of the hole in its own right; what is narrower belongs to its rim.
NEARBY_M = 0.15
COARSE_CELLS = 4
# Slopes along a contour are alike over this many cells, the reach of the smoothing.
ALIKE_CELLS = 8.0
# A blurred step lies at half its height; how far from it a level is still believed.
EDGE_SHARE = 0.5
EDGE_SHARE_SD = 0.2
# Exponent of 4 pi area / perimeter^2: holes break out in one piece, aprons and cracks run off.
COMPACT_EXPONENT = 0.5
# Walls that hide part of the hole are steeper than any ray: their rim is where the slope begins, at half its greatest.
HIDDEN_SHARE = 0.05
HIDDEN_SLOPE_SHARE = 0.5
# Holes cover less than this share of a survey, else the road is not known.
MAX_AREA_SHARE = 0.5
MIN_CELLS = 12


@dataclass(frozen=True, slots=True)
class Outline:
    """Cells (r, c) of a region, within the rows and columns of a map that it covers, and the mean slope of its rim."""

    extent: tuple[slice, slice]
    mask: MaskArray
    slope: float


@dataclass(frozen=True, slots=True)
class Family:
    """What lies deeper than one share of the depth nearby: components (R, C) with their extents.

    For each component its number of cells, of rim cells, of gap cells, the mean slope of its rim, the mean's standard
    error."""

    components: IntArray
    extents: list[tuple[slice, slice]]
    cells: FloatArray
    rim_cells: FloatArray
    gap_cells: FloatArray
    slope: FloatArray
    slope_error: FloatArray


def slope_of(depth_m: FloatArray, cell_m: float) -> FloatArray:
    """Magnitude (R, C) of the gradient of a map."""
    return np.asarray(np.hypot(sobel(depth_m, 0), sobel(depth_m, 1)) / (8.0 * cell_m))


def contour_families(
    depth_m: FloatArray, slope: FloatArray, gaps: MaskArray, cell_m: float, least_m: float
) -> list[Family]:
    """The components at each share; depth (R, C) is smoothed, `gaps` (R, C) were not measured and join what they touch.

    Nothing shallower than `least_m` belongs to any.
    """
    nearby = _depth_nearby(np.maximum(depth_m, 0.0), NEARBY_M / cell_m)
    return [_family(depth_m > np.maximum(share * nearby, least_m), gaps, slope) for share in SHARES]


def steepest(families: list[Family], place: tuple[int, int], taken: MaskArray, map_cells: float) -> Outline | None:
    """Outline around a place (row, column) that leaves alone what is taken (R, C); None where no level has one."""
    outlines = [_around(family, place) for family in families]
    free = np.array([o is not None and not (taken[o.extent] & o.mask).any() for o in outlines])
    if not free.any():
        return None
    numbers = np.array([family.components[place] for family in families]) * free
    values = np.array(
        [
            (f.cells[n], f.rim_cells[n], f.gap_cells[n], f.slope[n], f.slope_error[n]) if n else np.zeros(5)
            for f, n in zip(families, numbers, strict=True)
        ]
    )
    cells, rim, gap, slope, error = values.T
    fits = (cells - gap >= MIN_CELLS) & (cells <= MAX_AREA_SHARE * map_cells)
    if not fits.any():
        return None
    compact = 4.0 * np.pi * cells / np.square(np.maximum(rim, 1.0))
    prior = np.exp(-0.5 * np.square((SHARES - EDGE_SHARE) / EDGE_SHARE_SD))
    score = np.where(fits, _three_point_mean(slope) * prior * compact**COMPACT_EXPONENT, 0.0)
    best = int(np.argmax(score))
    if gap[best] > HIDDEN_SHARE * cells[best]:
        chosen = int(np.argmax(np.where(fits, slope, 0.0) >= HIDDEN_SLOPE_SHARE * slope[fits].max()))
    else:
        # Of the levels that the scatter of slopes cannot tell from the best, the outermost.
        chosen = int(np.argmax(score >= score[best] * (1.0 - error[best] / max(slope[best], 1e-12))))
    return outlines[chosen]


def _around(family: Family, place: tuple[int, int]) -> Outline | None:
    number = int(family.components[place])
    if number == 0:
        return None
    extent = family.extents[number - 1]
    return Outline(extent, family.components[extent] == number, float(family.slope[number]))


def _family(deep: MaskArray, gaps: MaskArray, slope: FloatArray) -> Family:
    deep = _filled(deep | gaps)
    components, count = label(deep)
    components = np.asarray(components, dtype=np.int64)
    rim = _rim(deep) & ~gaps

    def total(mask: MaskArray, weights: FloatArray | None = None) -> FloatArray:
        values = None if weights is None else weights[mask]
        return np.bincount(components[mask], weights=values, minlength=count + 1).astype(np.float64)

    n = np.maximum(total(rim), 1.0)
    mean = total(rim, slope) / n
    scatter = np.maximum(total(rim, np.square(slope)) / n - mean * mean, 0.0)
    error = np.sqrt(scatter * ALIKE_CELLS / n)
    return Family(components, find_objects(components), total(deep), n, total(deep & gaps), mean, error)


def _filled(mask: MaskArray) -> MaskArray:
    """The mask with what it encloses."""
    outside, count = label(~mask)
    open_ends = np.zeros(count + 1, dtype=bool)
    for line in (outside[0], outside[-1], outside[:, 0], outside[:, -1]):
        open_ends[line] = True
    return np.asarray(mask | ~open_ends[outside])


def _rim(mask: MaskArray) -> MaskArray:
    """Cells of the mask with a neighbour outside it, beyond the map counting as inside."""
    padded = np.pad(mask, 1, mode="edge")
    inner = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return np.asarray(mask & ~inner)


def _depth_nearby(depth_m: FloatArray, reach_cells: float) -> FloatArray:
    """Greatest depth within a reach of each cell (R, C), smoothed, on a coarse raster."""
    padded = np.pad(depth_m, [(0, -n % COARSE_CELLS) for n in depth_m.shape], mode="edge")
    rows, columns = (n // COARSE_CELLS for n in padded.shape)
    coarse = padded.reshape(rows, COARSE_CELLS, columns, COARSE_CELLS).max(axis=(1, 3))
    reach = min(max(reach_cells / COARSE_CELLS, 1.0), float(max(rows, columns)))
    y, x = np.mgrid[-int(reach) : int(reach) + 1, -int(reach) : int(reach) + 1]
    widest = grey_dilation(coarse, footprint=x * x + y * y <= reach * reach, mode="nearest")
    smoothed = gaussian_filter(widest, reach / 3.0, mode="nearest")
    full = np.repeat(np.repeat(smoothed, COARSE_CELLS, axis=0), COARSE_CELLS, axis=1)
    return np.asarray(full[: depth_m.shape[0], : depth_m.shape[1]])


def _three_point_mean(values: FloatArray) -> FloatArray:
    return np.convolve(np.pad(values, 1, mode="edge"), [0.25, 0.5, 0.25], mode="valid")
