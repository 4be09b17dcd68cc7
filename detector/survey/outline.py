"""Outlines of holes in a map of depth: of all levels, the one in the middle of the evidence for an edge.

A blurred step is steepest where the step is, whatever the blur; a worn apron is flatter than the broken edge inside it.
Levels are shares of the depth nearby and not of the whole hole's, so that a shallow bay keeps its own rim beside a
deep core. Each level weighs by how steep and how compact its contour is, and the median level is the outline: where
two edges run around a hole, it lies between them instead of at whichever is a little steeper.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects, gaussian_filter, grey_dilation, sobel

from detector.arrays import FloatArray, IntArray
from detector.survey.grid import components_of

MaskArray = NDArray[np.bool_]

# Shares of the depth nearby among which the steepest contour is sought.
SHARES = np.arange(0.05, 0.81, 0.05)
# A bay wider than a tyre is part of the hole in its own right; what is narrower belongs to its rim.
NEARBY_M = 0.2
COARSE_CELLS = 4
# Weight of a level: slope of the relative depth along its contour, and compactness 4 pi area / perimeter^2; holes break
# out in one piece, aprons and cracks run off.
SLOPE_EXPONENT = 2.0
COMPACT_EXPONENT = 0.5
# Walls that hide part of the hole are steeper than any ray: their rim is where the slope begins, at half its greatest.
HIDDEN_SHARE = 0.05
HIDDEN_SLOPE_SHARE = 0.5
# Holes cover less than this share of a survey, else the road is not known.
MAX_AREA_SHARE = 0.5
# A basin smaller than this share of the greatest is a hole of its own.
PART_SHARE = 0.3
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

    For each component its number of cells, of rim cells, of gap cells, the means along its rim of the slope and of the
    slope of the depth relative to the depth nearby, and whether an outline has taken cells of it.
    """

    components: IntArray
    extents: list[tuple[slice, slice]]
    cells: FloatArray
    rim_cells: FloatArray
    gap_cells: FloatArray
    slope: FloatArray
    relative_slope: FloatArray
    taken: MaskArray

    def take(self, outline: Outline) -> None:
        """Note that an outline has cells of these components."""
        self.taken[self.components[outline.extent][outline.mask]] = True


def slope_of(depth_m: FloatArray, cell_m: float) -> FloatArray:
    """Magnitude (R, C) of the gradient of a map."""
    return np.asarray(np.hypot(sobel(depth_m, 0), sobel(depth_m, 1)) / (8.0 * cell_m))


def contour_families(
    depth_m: FloatArray, nearby_m: FloatArray, slope: FloatArray, gaps: MaskArray, cell_m: float, least_m: float
) -> list[Family]:
    """The components at each share of the depth nearby; `gaps` (R, C) were not measured and join what they touch.

    Nothing shallower than `least_m` belongs to any.
    """
    relative = slope_of(depth_m / np.maximum(nearby_m, least_m), cell_m)
    return [_family(depth_m > np.maximum(share * nearby_m, least_m), gaps, slope, relative) for share in SHARES]


def outline_of(families: list[Family], seed: Outline, map_cells: float) -> Outline | None:
    """Outline of the hole that a seed lies in, leaving alone what is taken; None where no level has one.

    A level's great components on the seed count together: a hole with two basins is one, also where a level parts them.
    """
    parts = [_parts(family, seed) for family in families]
    values = np.array([_sums(family, numbers) for family, numbers in zip(families, parts, strict=True)])
    cells, rim, gap, slope, relative = values.T
    fits = (cells - gap >= MIN_CELLS) & (cells <= MAX_AREA_SHARE * map_cells)
    if not fits.any():
        return None
    compact = 4.0 * np.pi * cells / np.square(rim)
    chosen = _weighted_median(np.where(fits, relative**SLOPE_EXPONENT * compact**COMPACT_EXPONENT, 0.0))
    if gap[chosen] > HIDDEN_SHARE * cells[chosen]:
        chosen = int(np.argmax(np.where(fits, slope, 0.0) >= HIDDEN_SLOPE_SHARE * slope[fits].max()))
    return _union(families[chosen], parts[chosen], float(slope[chosen]))


def _parts(family: Family, seed: Outline) -> IntArray:
    """The components on a seed that are not much smaller than the greatest and leave alone what is taken."""
    on_seed = np.unique(family.components[seed.extent][seed.mask])
    parts = on_seed[(on_seed > 0) & ~family.taken[on_seed]]
    if parts.size == 0:
        return parts
    return np.asarray(parts[family.cells[parts] >= PART_SHARE * family.cells[parts].max()])


def _sums(family: Family, parts: IntArray) -> tuple[float, float, float, float, float]:
    """Cells, rim cells, gap cells, and the mean slope and relative slope along the rim, of some components together."""
    rim = family.rim_cells[parts]
    total = max(float(rim.sum()), 1.0)
    slope = float((rim * family.slope[parts]).sum()) / total
    relative = float((rim * family.relative_slope[parts]).sum()) / total
    return float(family.cells[parts].sum()), total, float(family.gap_cells[parts].sum()), slope, relative


def _union(family: Family, parts: IntArray, slope: float) -> Outline:
    extents = [family.extents[number - 1] for number in parts]
    rows, columns = (slice(min(e[axis].start for e in extents), max(e[axis].stop for e in extents)) for axis in (0, 1))
    return Outline((rows, columns), np.isin(family.components[rows, columns], parts), slope)


def _weighted_median(weight: FloatArray) -> int:
    """Index that half of the weight lies before, among those with any."""
    if weight.sum() <= 0.0:
        return int(np.argmax(weight))
    middle = int(np.searchsorted(np.cumsum(weight), 0.5 * weight.sum()))
    candidates = np.flatnonzero(weight > 0.0)
    return int(candidates[np.argmin(np.abs(candidates - middle))])


def _family(deep: MaskArray, gaps: MaskArray, slope: FloatArray, relative: FloatArray) -> Family:
    deep = _filled(deep | gaps)
    components, count = components_of(deep)
    rim = _rim(deep) & ~gaps

    def total(mask: MaskArray, weights: FloatArray | None = None) -> FloatArray:
        values = None if weights is None else weights[mask]
        return np.bincount(components[mask], weights=values, minlength=count + 1).astype(np.float64)

    n = np.maximum(total(rim), 1.0)
    extents = [(rows, columns) for rows, columns in find_objects(components)]
    means = (total(rim, slope) / n, total(rim, relative) / n)
    return Family(components, extents, total(deep), n, total(deep & gaps), *means, np.zeros(count + 1, dtype=bool))


def _filled(mask: MaskArray) -> MaskArray:
    """The mask with what it encloses."""
    outside, count = components_of(~mask)
    open_ends = np.zeros(count + 1, dtype=bool)
    for line in (outside[0], outside[-1], outside[:, 0], outside[:, -1]):
        open_ends[line] = True
    return np.asarray(mask | ~open_ends[outside])


def _rim(mask: MaskArray) -> MaskArray:
    """Cells of the mask with a neighbour outside it, beyond the map counting as inside."""
    padded = np.pad(mask, 1, mode="edge")
    inner = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return np.asarray(mask & ~inner)


def depth_nearby(depth_m: FloatArray, cell_m: float) -> FloatArray:
    """Greatest depth within reach of each cell (R, C), smoothed, on a coarse raster."""
    reach_cells = NEARBY_M / cell_m
    padded = np.pad(np.maximum(depth_m, 0.0), [(0, -n % COARSE_CELLS) for n in depth_m.shape], mode="edge")
    rows, columns = (n // COARSE_CELLS for n in padded.shape)
    coarse = padded.reshape(rows, COARSE_CELLS, columns, COARSE_CELLS).max(axis=(1, 3))
    reach = min(max(reach_cells / COARSE_CELLS, 1.0), float(max(rows, columns)))
    y, x = np.mgrid[-int(reach) : int(reach) + 1, -int(reach) : int(reach) + 1]
    widest = grey_dilation(coarse, footprint=x * x + y * y <= reach * reach, mode="nearest")
    smoothed = gaussian_filter(widest, reach / 3.0, mode="nearest")
    full = np.repeat(np.repeat(smoothed, COARSE_CELLS, axis=0), COARSE_CELLS, axis=1)
    return np.asarray(full[: depth_m.shape[0], : depth_m.shape[1]])
