"""What is worn into the road, or raised from it: heights over a local (x, y) grid, a footprint, and materials."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
MaterialArray = NDArray[np.uint8]

GRID_STEP_M = 0.01
"""Half of the road mesh's finest step, so that the mesh and not the shape limits the detail."""

GRAVEL_SD_M = 0.003
"""Loose fill of some centimetres' grain, levelled by tyres."""


class Material(IntEnum):
    """What a place on the road is made of."""

    ASPHALT = 0
    BROKEN = 1
    GRAVEL = 2
    WATER = 3
    PATCH = 4
    DEBRIS = 5
    MARK = 6


@dataclass(frozen=True, slots=True)
class Relief:
    """Height above (or, negative, below) the road around a centre, and the footprint that counts as obstacle.

    `heights_m` (rows y, columns x) is what a ray meets; `footprint`, and `floor_m` and `materials` where given, have
    its shape. All are sampled every `step_m`, the centre in the middle; beyond the grid the road is undisturbed.
    `length_m` is the extent of the footprint along x, `width_m` along y. Under standing water `heights_m` is the
    water's level and `floor_m` the ground below it: depth and volume, the truth, refer to the floor. Without
    `materials` a hole's inside is broken asphalt and all else is asphalt.
    """

    heights_m: FloatArray
    footprint: BoolArray
    step_m: float
    floor_m: FloatArray | None = None
    materials: MaterialArray | None = None

    def __post_init__(self) -> None:
        grids = [grid for grid in (self.footprint, self.floor_m, self.materials) if grid is not None]
        if self.heights_m.ndim != 2 or any(grid.shape != self.heights_m.shape for grid in grids):
            raise ValueError("a relief's grids must be of one shape (rows, columns)")
        if not np.isfinite(self.solid_m).all() or not np.isfinite(self.heights_m).all():
            raise ValueError("a relief's heights must be finite")
        if not self.footprint.any():
            raise ValueError("a relief's footprint covers nothing")
        if not (math.isfinite(self.step_m) and self.step_m > 0):
            raise ValueError(f"a relief's grid step must be positive, not {self.step_m} m")

    @property
    def solid_m(self) -> FloatArray:
        """Height of the solid surface: the floor where water stands, else what a ray meets."""
        return self.heights_m if self.floor_m is None else self.floor_m

    @property
    def is_hole(self) -> bool:
        """Whether the footprint lies below the road on the whole."""
        return float(self.solid_m[self.footprint].sum()) < 0

    @property
    def length_m(self) -> float:
        """Extent of the footprint along the local x."""
        return int(np.ptp(np.flatnonzero(self.footprint.any(axis=0))) + 1) * self.step_m

    @property
    def width_m(self) -> float:
        """Extent of the footprint along the local y."""
        return int(np.ptp(np.flatnonzero(self.footprint.any(axis=1))) + 1) * self.step_m

    @property
    def relief_m(self) -> float:
        """Greatest depth below or height above the road inside the footprint, never negative."""
        return float(np.abs(self.solid_m[self.footprint]).max())

    @property
    def footprint_area_m2(self) -> float:
        """Area of the footprint."""
        return float(np.count_nonzero(self.footprint)) * self.step_m**2

    @property
    def volume_m3(self) -> float:
        """Volume between the road and the solid surface inside the footprint, never negative."""
        return abs(float(self.solid_m[self.footprint].sum())) * self.step_m**2

    @property
    def reach_m(self) -> float:
        """Radius beyond which the road is undisturbed."""
        rows, columns = self.heights_m.shape
        return math.hypot(rows, columns) / 2 * self.step_m

    def height_at(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """Bilinear height of what a ray meets at local positions, 0 beyond the grid."""
        heights: FloatArray = ndimage.map_coordinates(self.heights_m, self._indices(x_m, y_m), order=1, cval=0.0)
        return heights

    def covers(self, x_m: FloatArray, y_m: FloatArray) -> BoolArray:
        """Whether local positions lie inside the footprint."""
        inside: BoolArray = ndimage.map_coordinates(self.footprint, self._indices(x_m, y_m), order=0, cval=False)
        return inside

    def material_at(self, x_m: FloatArray, y_m: FloatArray) -> MaterialArray:
        """`Material` at local positions, asphalt beyond the grid."""
        found: MaterialArray = ndimage.map_coordinates(
            self._materials(), self._indices(x_m, y_m), order=0, cval=int(Material.ASPHALT)
        )
        return found

    def grown(self, area_factor: float) -> Relief:
        """The same shape with `area_factor` times the footprint's area and the same relief."""
        return replace(self, step_m=self.step_m * math.sqrt(area_factor))

    def aged(self, growth_percent: float) -> Relief:
        """The shape after wear: the footprint's area, and the depth or height, larger by so many per cent each."""
        if not -50 <= growth_percent <= 300:
            raise ValueError(f"growth is -50 to 300 %, not {growth_percent}")
        factor = 1 + growth_percent / 100
        floor = None if self.floor_m is None else self.floor_m * factor
        return replace(self.grown(factor), heights_m=self.heights_m * factor, floor_m=floor)

    def filled(self, fraction: float, seed: int = 0) -> Relief:
        """The hole with loose gravel up to `fraction` of its depth, 1 being the road's level; water is displaced."""
        level = self._level_m(fraction)
        grain = np.random.default_rng(seed).standard_normal(self.heights_m.shape)
        gravel = level + GRAVEL_SD_M * np.clip(grain, -2, 2)
        covered = self.footprint & (self.solid_m < gravel) & (fraction > 0)
        materials = np.where(covered, np.uint8(Material.GRAVEL), self._materials())
        surface = np.where(covered, gravel, self.solid_m)
        filled = replace(self, heights_m=surface, floor_m=None, materials=materials)
        return filled if self.floor_m is None else filled._under_water(float(self.heights_m[self.footprint].min()))

    def flooded(self, fraction: float) -> Relief:
        """The hole with standing water up to `fraction` of its depth."""
        return self._under_water(self._level_m(fraction)) if fraction > 0 else self

    def _level_m(self, fraction: float) -> float:
        if not self.is_hole:
            raise ValueError("only a hole can be filled")
        if not 0 <= fraction <= 1:
            raise ValueError(f"a hole is filled to between 0 and 1 of its depth, not {fraction}")
        return float(self.solid_m[self.footprint].min()) * (1 - fraction)

    def _under_water(self, level_m: float) -> Relief:
        wet = self.footprint & (self.solid_m < level_m)
        materials = np.where(wet, np.uint8(Material.WATER), self._solid_materials())
        return replace(self, heights_m=np.where(wet, level_m, self.solid_m), floor_m=self.solid_m, materials=materials)

    def _solid_materials(self) -> MaterialArray:
        """The materials without the water that stands on them."""
        materials = self._materials()
        return np.where(materials == Material.WATER, np.uint8(Material.BROKEN), materials)

    def _materials(self) -> MaterialArray:
        if self.materials is not None:
            return self.materials
        return np.where(self.footprint & (self.heights_m < 0), Material.BROKEN, Material.ASPHALT).astype(np.uint8)

    def _indices(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        rows, columns = self.heights_m.shape
        return np.stack([y_m / self.step_m + (rows - 1) / 2, x_m / self.step_m + (columns - 1) / 2])
