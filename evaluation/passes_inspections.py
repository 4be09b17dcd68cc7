"""Verdicts about known places: of holes that are there, of holes that are gone, of places that cannot be seen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detector.passes.inspection import KnownPlace, inspect
from evaluation.passes_drive import Look
from evaluation.passes_sizes import beyond
from simulator.world import World

SPARSE_BEYOND_M = 10.5
"""Sweeps from farther than this show a place too flat and too sparsely for any size."""

HIDDEN_BELOW, SEEN_ABOVE = 0.5, 0.95
"""Of a footprint's cells: hidden if fewer are in sight of any sweep, not occluded if more are in sight of three."""

SIGHTS = 3
CELL_M = 0.1
CLEAR_M = 0.2
"""A ray that ends this close to the cell saw it."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """One inspection: what was there (`exists`), how it could be seen (`sight`), what was said."""

    street: int
    sensor: str
    speed_kmh: float
    own_lane: bool
    size: str
    exists: bool
    sight: str
    outcome: str
    reason: str


def verdicts_of(world: World, look: Look) -> Iterator[Verdict]:
    """The verdict about a look's place as it was seen, and about the same place seen only from far away."""
    place = look.known
    seen_once, seen_often = sight_shares(world, place, look.inspected.origins_m)
    sight = "clear" if seen_often > SEEN_ABOVE else "hidden" if seen_once < HIDDEN_BELOW else "partly"
    for seen, hits in ((sight, look.inspected), ("sparse", beyond(look.inspected, SPARSE_BEYOND_M))):
        verdict = inspect(hits, place)
        yield Verdict(
            look.street,
            look.drive.sensor,
            look.drive.speed_kmh,
            float(place.centre_odom_m[1]) * look.drive.direction < 0,
            size_class(place),
            look.placed is not None,
            seen,
            verdict.outcome,
            verdict.reason,
        )


def size_class(place: KnownPlace) -> str:
    """ "small" below the inspection's large class, "large" from it on, "rise" for what stands on the road."""
    if not place.is_negative:
        return "rise"
    return "large" if place.length_m >= 0.55 else "small"


def sight_shares(world: World, place: KnownPlace, origins_m: NDArray[np.float64]) -> tuple[float, float]:
    """Shares [0, 1] of the footprint's cells that one, and three, of the sensor's places (F, 3) have in clear sight."""
    cells = _cells(world, place)
    sights = np.zeros(len(cells), dtype=np.int64)
    for origin in origins_m:
        away = cells - origin
        distance = np.linalg.norm(away, axis=1)
        start = np.broadcast_to(origin, away.shape).astype(np.float32)
        hits = world.cast(start, (away / distance[:, None]).astype(np.float32))
        sights += hits.distance > distance - CLEAR_M
    return float((sights >= 1).mean()), float((sights >= SIGHTS).mean())


def _cells(world: World, place: KnownPlace) -> NDArray[np.float64]:
    """Centres (C, 3) of the footprint's cells on the sound road."""
    along, across = (
        np.arange(-side / 2.0 + CELL_M / 2.0, side / 2.0, CELL_M) for side in (place.length_m, place.width_m)
    )
    u, v = (grid.ravel() for grid in np.meshgrid(along, across))
    c, s = np.cos(place.yaw_rad), np.sin(place.yaw_rad)
    x, y = place.centre_odom_m[0] + c * u - s * v, place.centre_odom_m[1] + s * u + c * v
    return np.column_stack([x, y, world.street.sound_height(x, y)])


def verdict_figures(verdicts: Sequence[Verdict]) -> dict[str, float]:
    """Of a group: how many, shares in per cent with a verdict, and of wrong ones."""
    count = len(verdicts)
    present = sum(v.outcome == "present" for v in verdicts)
    absent = sum(v.outcome == "absent" for v in verdicts)
    wrong_absent = sum(v.outcome == "absent" and v.exists for v in verdicts)
    wrong_present = sum(v.outcome == "present" and not v.exists for v in verdicts)
    return {
        "places": count,
        "judged": 100 * (present + absent) / max(count, 1),
        "absent": 100 * absent / max(count, 1),
        "wrong_absent": 100 * wrong_absent / max(count, 1),
        "wrong_present": 100 * wrong_present / max(count, 1),
    }
