"""A look at the place of a known obstacle: is it there, is it gone, or could this pass not tell?

`absent` is only said where an obstacle of that size would have been seen: enough hits, steep enough, from enough
sweeps, everywhere on its footprint, with little noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.ndimage import label

from detector.arrays import FloatArray
from detector.passes.accumulator import PlaceHits
from detector.passes.height_map import CELL_M as MAP_CELL_M
from detector.passes.height_map import Grid, Map
from detector.passes.local_surface import Levelled, levelled, usable
from detector.passes.pass_maps import relief_map
from detector.road.robust import robust_sd

Outcome = Literal["present", "absent", "not_visible"]

# Wrong "absent" was at most 0.3 % for large obstacles and 2.2 % for small ones where these held.
LARGE_M = (0.60, 0.45, 0.10)
SMALL_M = (0.35, 0.30, 0.05)
LARGE_STEEPNESS = 0.16
SMALL_STEEPNESS = 0.32
MIN_HITS_PER_M2 = 60.0
# An obstacle shows with fewer than its absence does; with less than this, so does noise.
PRESENT_HITS_PER_M2 = 30.0
MIN_FRAMES = 3
CELL_M = 0.1
MIN_FILLED = 0.8
MAX_CELL_NOISE_M = 0.007
# Ring of road around the footprint that must be seen too, or the surface is not known.
BORDER_M = 0.5
# The stored place is searched within two standard deviations.
PLACE_SDS = 2.0
# Of the stored depth (height) and box area, what is enough to be the obstacle, and what is too little to be any.
PRESENT_RELIEF, PRESENT_AREA = 0.4, 0.2
ABSENT_RELIEF, ABSENT_AREA = 0.25, 0.1
MIN_RELIEF_M = 0.02
# The stored size carries an error: a hole stored 2 mm below a class's limit belongs to it.
SIZE_TOLERANCE = 0.9


@dataclass(frozen=True, slots=True)
class KnownPlace:
    """Where an obstacle should be, in `odom`: centre (3,), box, depth or height, sign, and the standard deviation of
    the place relative to the car (both position errors together, per axis)."""

    centre_odom_m: FloatArray
    length_m: float
    width_m: float
    yaw_rad: float
    relief_m: float
    is_negative: bool
    place_sd_m: float

    @property
    def reach_m(self) -> float:
        """How far from the stored footprint the obstacle may lie."""
        return PLACE_SDS * self.place_sd_m

    @property
    def half_size_m(self) -> float:
        """Half the side of the window of hits that `inspect` needs."""
        return 0.5 * float(np.hypot(self.length_m, self.width_m)) + self.reach_m + BORDER_M + CELL_M

    def is_at_least(self, size_m: tuple[float, float, float]) -> bool:
        """Whether length, width and relief reach those of a class, within the tolerance of a stored size."""
        mine = (self.length_m, self.width_m, self.relief_m)
        return all(value >= SIZE_TOLERANCE * limit for value, limit in zip(mine, size_m, strict=True))


@dataclass(frozen=True, slots=True)
class PlaceVerdict:
    """What was found, the share [0, 1] of the place (footprint and position error) that was seen, and why."""

    outcome: Outcome
    visible_fraction: float
    reason: str


def inspect(hits: PlaceHits, place: KnownPlace) -> PlaceVerdict:
    """Verdict about a known obstacle from the hits of a pass around it (a window of `place.half_size_m`)."""
    hits = usable(hits)
    filled, visible = _coverage(hits, place)
    if hits.frames < MIN_FRAMES or len(hits.points_m) < MIN_HITS_PER_M2:
        return PlaceVerdict("not_visible", visible, "too few sweeps or hits at the place")
    level = levelled(hits)
    if _density_per_m2(hits, level, place) < PRESENT_HITS_PER_M2:
        return PlaceVerdict("not_visible", visible, "too few hits")
    found = _found(hits, level, place)
    if found == "present":
        return PlaceVerdict("present", visible, "an obstacle of this sign and size lies here")
    blind = _why_blind(hits, level, place, filled)
    if blind is not None:
        return PlaceVerdict("not_visible", visible, blind)
    if found == "unsure":
        return PlaceVerdict("not_visible", visible, "something smaller or shallower lies here")
    return PlaceVerdict("absent", visible, "the road is whole where the obstacle would have been seen")


def _in_box(xy_m: FloatArray, place: KnownPlace, margin_m: float) -> np.ndarray:
    """Mask of positions (N, 2) in `odom` inside the footprint widened by a margin."""
    offset = xy_m - place.centre_odom_m[:2]
    c, s = np.cos(place.yaw_rad), np.sin(place.yaw_rad)
    along = np.abs(c * offset[:, 0] + s * offset[:, 1])
    across = np.abs(-s * offset[:, 0] + c * offset[:, 1])
    return np.asarray((along <= place.length_m / 2.0 + margin_m) & (across <= place.width_m / 2.0 + margin_m))


def _coverage(hits: PlaceHits, place: KnownPlace) -> tuple[float, float]:
    """Share of 0.1 m cells hit: of place and border, and of the place alone."""
    cells = int(np.ceil(2.0 * place.half_size_m / CELL_M))
    index = np.floor((hits.points_m[:, :2] - place.centre_odom_m[:2] + place.half_size_m) / CELL_M).astype(np.int64)
    index = index[((index >= 0) & (index < cells)).all(axis=1)]
    hit = np.zeros((cells, cells), dtype=bool)
    hit[index[:, 0], index[:, 1]] = True
    axis = (np.arange(cells) + 0.5) * CELL_M - place.half_size_m
    centres = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2) + place.centre_odom_m[:2]
    needed = _in_box(centres, place, place.reach_m + BORDER_M)
    core = _in_box(centres, place, place.reach_m + CELL_M / 2.0)
    return float(hit.ravel()[needed].mean()), float(hit.ravel()[core].mean())


def _found(hits: PlaceHits, level: Levelled, place: KnownPlace) -> Literal["present", "unsure", "empty"]:
    """Whether the map of depth or height shows the obstacle, a trace of something, or nothing."""
    grid = Grid(hits.half_size_m)
    relief = relief_map(level.xy_m, -level.height_m if place.is_negative else level.height_m, grid)
    axis = grid.centres_m()
    centres = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2) + hits.centre_odom_m
    searched = _in_box(centres, place, place.reach_m).reshape(relief.shape)
    box_area = place.length_m * place.width_m
    if _largest_area(relief, searched, max(PRESENT_RELIEF * place.relief_m, MIN_RELIEF_M)) > PRESENT_AREA * box_area:
        return "present"
    trace = _largest_area(relief, searched, max(ABSENT_RELIEF * place.relief_m, MIN_RELIEF_M))
    return "unsure" if trace > ABSENT_AREA * box_area else "empty"


def _largest_area(relief: Map, searched: np.ndarray, threshold_m: float) -> float:
    """Area in square metres of the largest connected region above a threshold, inside what is searched."""
    labels, count = label((relief > threshold_m) & searched)
    return float(np.bincount(labels.ravel())[1:].max()) * MAP_CELL_M**2 if count else 0.0


def _why_blind(hits: PlaceHits, level: Levelled, place: KnownPlace, filled: float) -> str | None:
    """Why an obstacle of this size might have been missed; None if it would have been seen."""
    if not place.is_at_least(SMALL_M):
        return "smaller than any obstacle whose absence can be seen"
    steepness = LARGE_STEEPNESS if place.is_at_least(LARGE_M) else SMALL_STEEPNESS
    if _density_per_m2(hits, level, place) < MIN_HITS_PER_M2:
        return "too few hits"
    # Flatter hits of the same pass take nothing away from what the steep ones show.
    if _density_per_m2(hits, level, place, steepness) < MIN_HITS_PER_M2:
        return "seen too flat for its size"
    if filled < MIN_FILLED:
        return "part of the place was hidden"
    if _cell_noise(level) > MAX_CELL_NOISE_M:
        return "too noisy for its size"
    return None


def _density_per_m2(hits: PlaceHits, level: Levelled, place: KnownPlace, steepness: float = 0.0) -> float:
    """Hits at least so steep per square metre of place and border."""
    margin_m = place.reach_m + BORDER_M
    near = _in_box(hits.centre_odom_m + level.xy_m, place, margin_m) & (level.tangent >= steepness)
    return float(near.sum()) / ((place.length_m + 2.0 * margin_m) * (place.width_m + 2.0 * margin_m))


def _cell_noise(level: Levelled) -> float:
    """Robust standard deviation of the mean heights of the 0.1 m cells."""
    index = np.floor(level.xy_m / CELL_M).astype(np.int64)
    _, cell = np.unique(index, axis=0, return_inverse=True)
    return robust_sd(np.bincount(cell.ravel(), weights=level.height_m) / np.bincount(cell.ravel()))
