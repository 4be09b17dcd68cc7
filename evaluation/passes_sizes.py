"""Boxes of single passes against the simulator's truth: how right, how honest about it, and how well they repeat."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.geometry import Kind
from detector.obstacles.descriptor import moment_box, polygon_moments
from detector.passes.accumulator import PlaceHits
from detector.passes.shape import measure
from detector.types import DetectedObstacle
from evaluation.passes_drive import Look
from evaluation.passes_street import hole_size
from simulator.shapes.footprint import footprint_polygon
from simulator.streets.street import PlacedObstacle

FRONT_AND_REAR, FRONT = "front and rear", "front"

SIZED, RANDOM = "sized", "random"
"""Streets with holes of three sizes, and with obstacles of every size."""

EVERY = (1, 2, 4)
"""Of the sweeps, every one, every second and every fourth are used, to show what the number of frames does."""

SIDE_SHARE, SIDE_M = 0.10, 0.05
RELIEF_SHARE, RELIEF_M = 0.15, 0.015
"""A side is right within 10 % or 5 cm, a depth or height within 15 % or 1.5 cm."""


@dataclass(frozen=True, slots=True)
class Truth:
    """The label's box (the footprint's extent at the road's level), greatest depth or height, volume, and the box of
    the footprint's second moments, which is what `detector.passes.shape` states for what is part of the road."""

    length_m: float
    width_m: float
    relief_m: float
    volume_m3: float
    moment_length_m: float
    moment_width_m: float


@dataclass(frozen=True, slots=True)
class Measured:
    """One measurement: of which obstacle, from which pass, with which sweeps; `measured` is None if there was none."""

    street: int
    scene: str
    sensor: str
    speed_kmh: float
    direction: int
    own_lane: bool
    obstacle_id: int
    size: str
    view: str
    every: int
    truth: Truth
    measured: DetectedObstacle | None

    @property
    def place(self) -> tuple[str, int, int]:
        """Which obstacle of which street."""
        return self.scene, self.street, self.obstacle_id


Group = tuple[str, ...]


def measured_of(look: Look, scene: str) -> Iterator[Measured]:
    """The measurements of one look at an obstacle: front and rear, front only, and of known sizes with fewer sweeps."""
    placed = look.placed
    if placed is None:
        return
    size, truth = placed.kind.value, truth_of(placed)
    if scene == SIZED:
        size = hole_size(placed) or size
    views = [(FRONT_AND_REAR, every, every_nth(look.hits, every)) for every in (EVERY if scene == SIZED else EVERY[:1])]
    for view, every, hits in [*views, (FRONT, 1, before_passing(look.hits))]:
        yield Measured(
            look.street,
            scene,
            look.drive.sensor,
            look.drive.speed_kmh,
            look.drive.direction,
            placed.y_m * look.drive.direction < 0,
            placed.obstacle_id,
            size,
            view,
            every,
            truth,
            measure(hits, placed.kind is Kind.POTHOLE),
        )


def truth_of(placed: PlacedObstacle) -> Truth:
    """What the simulator knows of an obstacle's size."""
    shape = placed.shape
    width, length = sorted((shape.length_m, shape.width_m))
    moment_length, moment_width, _ = moment_box(polygon_moments(footprint_polygon(shape)))
    return Truth(length, width, shape.relief_m, shape.volume_m3, moment_length, moment_width)


def before_passing(hits: PlaceHits) -> PlaceHits:
    """Only the hits of sweeps taken before the place was passed."""
    if hits.frames == 0:
        return hits
    travel = hits.origins_m[-1, :2] - hits.origins_m[0, :2]
    return _only(hits, (hits.centre_odom_m - hits.origins_m[:, :2]) @ travel >= 0.0)


def every_nth(hits: PlaceHits, every: int) -> PlaceHits:
    """Only the hits of every nth sweep."""
    return hits if every == 1 else _only(hits, np.arange(hits.frames) % every == 0)


def beyond(hits: PlaceHits, range_m: float) -> PlaceHits:
    """Only the hits of sweeps taken from farther than a distance."""
    away_m = np.hypot(*(hits.origins_m[:, :2] - hits.centre_odom_m).T)
    return _only(hits, away_m > range_m)


def _only(hits: PlaceHits, chosen: NDArray[np.bool_]) -> PlaceHits:
    kept, number = chosen[hits.frame], np.cumsum(chosen) - 1
    return PlaceHits(
        hits.points_m[kept], number[hits.frame[kept]], hits.origins_m[chosen], hits.centre_odom_m, hits.half_size_m
    )


def grouped(rows: Iterable[Measured], key: Callable[[Measured], Group]) -> dict[Group, list[Measured]]:
    """Rows by a key, in the order of their first appearance."""
    groups: dict[Group, list[Measured]] = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row)
    return groups


def size_figures(rows: Sequence[Measured]) -> dict[str, float]:
    """Of a group: how many were measured, mean and spread of the ratios to the truth, and shares in per cent right.

    The truth is the label's box; on random streets, for what is part of the road, that of the footprint's moments: the
    sides of a lobed hole's label lie along other axes than its length.
    """
    pairs = [(_along_own_axes(row), row.measured) for row in rows if row.measured is not None]
    figures: dict[str, float] = {"passes": len(rows), "measured": len(pairs)}
    if not pairs:
        return figures
    for name, share, least_m in (
        ("length", SIDE_SHARE, SIDE_M),
        ("width", SIDE_SHARE, SIDE_M),
        ("relief", RELIEF_SHARE, RELIEF_M),
    ):
        true = np.array([getattr(truth, f"{name}_m") for truth, _ in pairs])
        found = np.array([getattr(obstacle, f"{name}_m") for _, obstacle in pairs])
        figures[f"{name}_ratio"], figures[f"{name}_ratio_sd"] = (
            float((found / true).mean()),
            float((found / true).std()),
        )
        figures[f"{name}_right"] = 100 * float((np.abs(found - true) <= np.maximum(share * true, least_m)).mean())
    volume = np.array([obstacle.volume_m3 / truth.volume_m3 for truth, obstacle in pairs])
    figures["volume_ratio"], figures["volume_ratio_sd"] = float(volume.mean()), float(volume.std())
    return figures


def _along_own_axes(row: Measured) -> Truth:
    if row.scene == SIZED or row.size == Kind.DEBRIS.value:
        return row.truth
    return replace(row.truth, length_m=row.truth.moment_length_m, width_m=row.truth.moment_width_m)


def honesty_figures(rows: Sequence[Measured]) -> dict[str, float]:
    """Share in per cent of errors within one standard deviation: of sides against the footprint's moment box (for
    things its label), of depth or height against the greatest, of the area against the mean of the place's passes."""
    mean_ln_area = _mean_ln_area(rows)
    ratios: dict[str, list[float]] = {name: [] for name in ("length", "width", "area", "relief")}
    for row in rows:
        truth, found = row.truth, row.measured
        if found is None:
            continue
        is_thing = row.size == Kind.DEBRIS.value
        true_length = truth.length_m if is_thing else truth.moment_length_m
        true_width = truth.width_m if is_thing else truth.moment_width_m
        length, width = math.log(found.length_m / true_length), math.log(found.width_m / true_width)
        ratios["length"].append(abs(length) / found.ln_length_sd)
        ratios["width"].append(abs(width) / found.ln_width_sd)
        mean, passes = mean_ln_area[row.sensor, row.place]
        if passes > 1:
            # Every pass pulls the mean towards itself.
            away = abs(math.log(found.length_m * found.width_m) - mean) * math.sqrt(passes / (passes - 1))
            ratios["area"].append(away / found.ln_area_sd)
        ratios["relief"].append(abs(found.relief_m - truth.relief_m) / found.relief_sd_m)
    return {name: 100 * float(np.mean(np.array(values) <= 1.0)) for name, values in ratios.items() if values}


def _mean_ln_area(rows: Sequence[Measured]) -> dict[tuple[str, tuple[str, int, int]], tuple[float, int]]:
    """Mean of ln(area) of the passes of each sensor over each place, and their number."""
    values: dict[tuple[str, tuple[str, int, int]], list[float]] = {}
    for row in rows:
        if row.measured is not None:
            values.setdefault((row.sensor, row.place), []).append(
                math.log(row.measured.length_m * row.measured.width_m)
            )
    return {key: (float(np.mean(areas)), len(areas)) for key, areas in values.items()}


def repeat_figures(rows: Sequence[Measured]) -> dict[str, float]:
    """Standard deviations in per cent between passes of the same place, pooled over places: box area and relief."""
    area: dict[tuple[str, int, int], list[float]] = {}
    relief: dict[tuple[str, int, int], list[float]] = {}
    for row in rows:
        if row.measured is not None:
            area.setdefault(row.place, []).append(math.log(row.measured.length_m * row.measured.width_m))
            relief.setdefault(row.place, []).append(math.log(row.measured.relief_m))
    return {"area_sd": _pooled(area), "relief_sd": _pooled(relief), "passes": sum(map(len, area.values()))}


def _pooled(values: dict[tuple[str, int, int], list[float]]) -> float:
    freedoms = sum(len(v) - 1 for v in values.values() if len(v) > 1)
    squares = sum(float(np.var(v)) * len(v) for v in values.values() if len(v) > 1)
    return 100 * math.sqrt(squares / freedoms) if freedoms else math.nan
