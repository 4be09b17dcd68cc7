"""Potholes from parameters: outline, walls, floor, rim, water, repair."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from simulator.shapes.hump import bump
from simulator.shapes.outline import local_grid, noise, one_piece, outline_radius, smoothstep
from simulator.shapes.relief import GRID_STEP_M, Material, Relief

__all__ = ["GRID_STEP_M", "PotholeShape", "Relief", "bump", "pothole"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

FLOOR_SHARE = 0.86
"""Mean depth of a floor before its texture, as a share of the deepest place."""

LIMITS = {
    "length_m": (0.10, 3.0),
    "width_m": (0.10, 3.0),
    "depth_m": (0.01, 0.5),
    "wall_m": (0.01, 1.0),
    "outline_roughness": (0.0, 0.15),
    "rim_roughness_m": (0.0, 0.02),
    "rim_crest_m": (0.0, 0.03),
    "water": (0.0, 1.0),
}
"""100 mm is the least diameter that ASTM D6433 counts as a pothole."""


@dataclass(frozen=True, slots=True)
class PotholeShape:
    """Parameters of a pothole; `relief(seed)` makes one. Sizes outside `LIMITS` are a `ValueError`.

    `length_m` x `width_m` is the box that the outline fills, the length along x; `wall_m` the width of the sloped
    wall. `outline_roughness` is the relative standard deviation of the outline's radius, `rim_roughness_m` that of the
    jagged edge, `rim_crest_m` the height to which broken asphalt stands up around it. `floor_texture` holds
    (wavelength in metres, share of the depth) of each scale of roughness. Of several `lobes` the holes overlap and
    share one outline. `water` is the share of the depth under water. A `repaired` hole is a patch within a centimetre
    of the road's level: no hazard.
    """

    length_m: float
    width_m: float
    depth_m: float
    wall_m: float = 0.10
    outline_roughness: float = 0.07
    rim_roughness_m: float = 0.0
    rim_crest_m: float = 0.006
    floor_texture: tuple[tuple[float, float], ...] = ((0.15, 0.10), (0.02, 0.05))
    lobes: int = 1
    water: float = 0.0
    repaired: bool = False

    def __post_init__(self) -> None:
        for name, (low, high) in LIMITS.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"{name} of a pothole must be between {low} and {high}, not {value}")
        if not 1 <= self.lobes <= 5:
            raise ValueError(f"lobes of a pothole must be between 1 and 5, not {self.lobes}")
        shares = [share for _, share in self.floor_texture]
        if not all(0.01 <= wave <= 1 for wave, _ in self.floor_texture) or any(share < 0 for share in shares):
            raise ValueError("floor_texture holds (wavelength of 0.01 to 1 m, share of the depth) of each scale")
        # Noise is clipped at two standard deviations: the floor stays below the road.
        if not sum(shares) <= FLOOR_SHARE / 2 - 0.03:
            raise ValueError(f"the shares of floor_texture must add up to at most {FLOOR_SHARE / 2 - 0.03:.2f}")

    @classmethod
    def random(cls, seed: int) -> PotholeShape:
        """A plausible hole that is no repair.

        Sizes spread over the classes of ASTM D6433 (mean diameter 100 to 750 mm, depth 13 to over 50 mm) from the
        150 mm on that the LTPP distress manual (FHWA-HRT-13-092) counts; depths over the manual's moderate (25 mm)
        and high (50 mm) classes, to the 150 mm of a thick bound layer. Walls of 30 to 45 degrees and more are those
        of fresh holes, flat ones of worn holes.
        """
        rng = np.random.default_rng([seed, 1])
        length = float(np.clip(rng.lognormal(math.log(0.55), 0.45), 0.20, 1.6))
        width = max(length * float(rng.uniform(0.5, 1.0)), 0.15)
        # Small holes have not had the time, or the room, to become deep.
        depth = min(float(np.clip(rng.lognormal(math.log(0.065), 0.45), 0.025, 0.15)), width / 3)
        return cls(
            length_m=round(length, 3),
            width_m=round(width, 3),
            depth_m=round(depth, 3),
            wall_m=round(float(rng.uniform(0.5, 2.0)) * depth, 3),
            outline_roughness=round(float(rng.uniform(0.05, 0.11)), 3),
            rim_roughness_m=round(float(rng.uniform(0.003, 0.010)), 4),
            rim_crest_m=round(float(rng.uniform(0.002, 0.012)), 4),
            floor_texture=(
                (0.15, round(float(rng.uniform(0.05, 0.15)), 3)),
                (0.05, round(float(rng.uniform(0.03, 0.10)), 3)),
                (0.02, round(float(rng.uniform(0.02, 0.08)), 3)),
            ),
            lobes=int(rng.choice([1, 2, 3], p=[0.6, 0.28, 0.12])),
            water=round(float(rng.uniform(0.3, 0.9)), 2) if rng.random() < 0.2 else 0.0,
        )

    def relief(self, seed: int) -> Relief:
        """The pothole of that seed: its deepest place is `depth_m` deep (a patch stays within a centimetre)."""
        rng = np.random.default_rng(seed)
        x_m, y_m = local_grid(self.length_m, self.width_m, margin=1.45)
        rho = outline_radius(rng, x_m, y_m, self.length_m, self.width_m, self.outline_roughness, self.lobes)
        inside_m = (1 - rho) * math.sqrt(self.length_m * self.width_m) / 2
        if self.repaired:
            return _patch(rng, inside_m)
        return self._hole(rng, rho, inside_m).flooded(self.water)

    def _hole(self, rng: np.random.Generator, rho: FloatArray, inside_m: FloatArray) -> Relief:
        slope = 1 + 0.35 * noise(rng, rho.shape, 0.12)
        texture = sum(share * noise(rng, rho.shape, wave) for wave, share in self.floor_texture)
        uneven_crest = np.maximum(1 + 0.7 * noise(rng, rho.shape, 0.05), 0)
        inside_m = inside_m + self.rim_roughness_m * noise(rng, rho.shape, 0.08) * smoothstep((1.3 - rho) / 0.2)
        footprint = one_piece(inside_m > 0)
        shares = np.where(footprint, smoothstep(inside_m / self.wall_m * slope) * (FLOOR_SHARE + texture), 0.0)
        # Broken asphalt stands up within a hand's breadth of the edge.
        crest_m = self.rim_crest_m * np.exp(-(((inside_m + 0.03) / 0.03) ** 2)) * uneven_crest
        crest_m *= smoothstep((1.4 - rho) / 0.3)
        footprint, shares, crest_m = self._in_its_box(footprint, shares, crest_m)
        return Relief(np.where(footprint, -self.depth_m * shares / shares.max(), crest_m), footprint, GRID_STEP_M)

    def _in_its_box(
        self, footprint: BoolArray, shares: FloatArray, crest_m: FloatArray
    ) -> tuple[BoolArray, FloatArray, FloatArray]:
        """Grids moved and stretched so that the footprint, whose edge was made ragged, fills its box again."""
        rows, columns = (np.flatnonzero(footprint.any(axis=axis)) for axis in (1, 0))
        at = [
            (found[0] + found[-1]) / 2 + (np.arange(size) - (size - 1) / 2) * (len(found) * GRID_STEP_M / side_m)
            for found, size, side_m in zip((rows, columns), footprint.shape, (self.width_m, self.length_m), strict=True)
        ]
        positions = np.stack(np.meshgrid(*at, indexing="ij"))
        inside: BoolArray = ndimage.map_coordinates(footprint, positions, order=0)
        shares, crest_m = (ndimage.map_coordinates(grid, positions, order=1) for grid in (shares, crest_m))
        return one_piece(inside), shares, crest_m

    def parameters(self) -> dict[str, object]:
        """Names and values, as a label file states them."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def pothole(seed: int, length_m: float, width_m: float, depth_m: float, wall_m: float = 0.10) -> Relief:
    """Hole with an irregular outline, sloped walls `wall_m` wide, a rough floor and a slightly raised, broken rim."""
    return PotholeShape(length_m, width_m, depth_m, wall_m).relief(seed)


def _patch(rng: np.random.Generator, inside_m: FloatArray) -> Relief:
    """Hand-laid asphalt: a little proud or sunk, rolled, with a ragged overlap onto the old road."""
    level_m = rng.uniform(-0.005, 0.007)
    # The overlap of 4 cm keeps the seam closed.
    share = smoothstep((inside_m + 0.04 + 0.01 * noise(rng, inside_m.shape, 0.06)) / 0.05)
    heights = share * (level_m + 0.0012 * noise(rng, inside_m.shape, 0.04))
    materials = np.where(share > 0.3, Material.PATCH, Material.ASPHALT).astype(np.uint8)
    return Relief(heights, inside_m > 0, GRID_STEP_M, materials=materials)
