"""The demo's outcome as values: every decision in order, and how far ahead the second car was warned."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from headsup.demo.record import DecisionRow, DriveRecord, true_name
from simulator.streets.street import Street

WARNED_CAR = "ego2"

STORY = ("created", "kept", "updated", "absent", "removed")


@dataclass(frozen=True, slots=True)
class Warned:
    """One obstacle and the second car: distances along the road to the obstacle, and the lead over its own LiDAR."""

    obstacle: str
    told_distance_m: float
    warned_distance_m: float
    warned_before_arrival_s: float
    seen_distance_m: float
    lead_m: float
    lead_s: float


@dataclass(frozen=True, slots=True)
class Summary:
    """What the demo showed."""

    seed: int
    real_scans: bool
    speed_mps: float
    decisions: tuple[DecisionRow, ...]
    warnings: tuple[Warned, ...]

    def untold(self) -> list[str]:
        """Of the decisions that the story is about, those that were never made."""
        made = {row.decision for row in self.decisions}
        return [decision for decision in STORY if decision not in made]


def write_summary(path: Path, street: Street, records: Sequence[DriveRecord], *, seed: int, scans: bool) -> Summary:
    """Gather the drives' records and write them as JSON."""
    summary = Summary(
        seed=seed,
        real_scans=scans,
        speed_mps=records[0].speed_mps,
        decisions=tuple(_named([row for record in records for row in record.rows])),
        warnings=tuple(_warnings(street, next(r for r in records if r.car == WARNED_CAR))),
    )
    path.write_text(json.dumps(asdict(summary), indent=1, default=str) + "\n")
    return summary


def _named(rows: Sequence[DecisionRow]) -> list[DecisionRow]:
    """Inspections name an obstacle by its id only; its detection said which one that is."""
    names = {row.obstacle_id: row.obstacle for row in rows if row.obstacle and row.obstacle_id is not None}
    return [
        row if row.obstacle or row.obstacle_id is None else replace(row, obstacle=names.get(row.obstacle_id, "unknown"))
        for row in rows
    ]


def _warnings(street: Street, record: DriveRecord) -> list[Warned]:
    warnings = []
    for placed in street.obstacles:
        known = record.knowledge.get(true_name(street, placed.obstacle_id))
        if known is None or known.told is None or known.advised is None or known.seen is None:
            continue
        distance_m = placed.x_m - known.advised.street_x_m
        warnings.append(
            Warned(
                obstacle=true_name(street, placed.obstacle_id),
                told_distance_m=round(placed.x_m - known.told.street_x_m, 1),
                warned_distance_m=round(distance_m, 1),
                warned_before_arrival_s=round(distance_m / record.speed_mps, 1),
                seen_distance_m=round(placed.x_m - known.seen.street_x_m, 1),
                lead_m=round(known.seen.street_x_m - known.advised.street_x_m, 1),
                lead_s=round(known.seen.time_s - known.advised.time_s, 1),
            )
        )
    return warnings
