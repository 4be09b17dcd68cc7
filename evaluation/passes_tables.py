"""The figures of all passes as records: one list per table, one record per row."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from evaluation.passes_descriptors import descriptor_figures
from evaluation.passes_inspections import Verdict, verdict_figures
from evaluation.passes_run import PassRecord
from evaluation.passes_sizes import (
    EVERY,
    FRONT,
    FRONT_AND_REAR,
    RANDOM,
    SIZED,
    Measured,
    grouped,
    honesty_figures,
    repeat_figures,
    size_figures,
)
from evaluation.passes_street import HOLE_SIZES

Record = dict[str, Any]
"""Names of groups as text, figures as numbers."""

SIZES = ("S", "M", "L", "pothole", "bump", "debris")


def tables(record: PassRecord) -> dict[str, list[Record]]:
    """Sizes, honesty of the standard deviations, repeatability, descriptors, inspections."""
    every, rows = record.measured, [row for row in record.measured if row.scene == SIZED]
    return {
        "size": [
            {"street": scene, **line}
            for scene in (SIZED, RANDOM)
            for view in (FRONT_AND_REAR, FRONT)
            for line in _size(_of([row for row in every if row.scene == scene], view))
        ],
        "honesty": [line for view in (FRONT_AND_REAR, FRONT) for line in _honesty(_of(every, view))],
        "repeatability": [
            line
            for view, nth in (*((FRONT_AND_REAR, nth) for nth in EVERY), (FRONT, 1))
            for line in _repeat(_of(rows, view, nth))
        ],
        "descriptor": _descriptor(every),
        "inspection": _inspection(record.verdicts),
    }


def _of(rows: Sequence[Measured], view: str, every: int = 1) -> list[Measured]:
    return [row for row in rows if row.view == view and row.every == every]


def _size(rows: Sequence[Measured]) -> list[Record]:
    return [
        {"sensor": sensor, "view": group[0].view, "obstacle": size, **size_figures(group)}
        for (sensor, size), group in grouped(_ordered(rows), lambda row: (row.sensor, row.size)).items()
    ]


def _honesty(rows: Sequence[Measured]) -> list[Record]:
    """By sign: what is stated of a hole, of a bump, of a thing."""
    return [
        {"sensor": sensor, "view": group[0].view, "obstacle": kind, **honesty_figures(group)}
        for (sensor, kind), group in grouped(_ordered(rows), lambda row: (row.sensor, _kind(row))).items()
    ]


def _repeat(rows: Sequence[Measured]) -> list[Record]:
    """By lane: in the car's own lane a hole lies up to a metre and a half beside the sensor, else two to five."""
    records = []
    for (sensor, size), group in grouped(_ordered(rows), lambda row: (row.sensor, row.size)).items():
        own = [row for row in group if row.own_lane]
        by_speed = grouped(own, lambda row: (f"{row.speed_kmh:.0f}",))
        frames = [row.measured.frames for row in group if row.measured is not None]
        records.append(
            {
                "sensor": sensor,
                "view": group[0].view,
                "obstacle": size,
                "sweeps": round(sum(frames) / max(len(frames), 1)),
                "own_lane_area_sd": repeat_figures(own)["area_sd"],
                "other_lane_area_sd": repeat_figures([row for row in group if not row.own_lane])["area_sd"],
                **{f"at_{speed}_kmh_area_sd": repeat_figures(some)["area_sd"] for (speed,), some in by_speed.items()},
                **repeat_figures(group),
            }
        )
    return records


def _descriptor(rows: Sequence[Measured]) -> list[Record]:
    return [
        {"street": scene, "sensor": sensor, "view": view, **descriptor_figures(group)}
        for view in (FRONT_AND_REAR, FRONT)
        for (scene, sensor), group in grouped(_of(rows, view), lambda row: (row.scene, row.sensor)).items()
    ]


def _inspection(verdicts: Sequence[Verdict]) -> list[Record]:
    groups: dict[tuple[str, str, str, str], list[Verdict]] = {}
    for verdict in verdicts:
        there = "there" if verdict.exists else "gone"
        groups.setdefault((verdict.sensor, verdict.sight, there, verdict.size), []).append(verdict)
    return [
        {"sensor": sensor, "sight": sight, "obstacle": size, "truth": there, **verdict_figures(group)}
        for (sensor, sight, there, size), group in sorted(groups.items())
    ]


def _kind(row: Measured) -> str:
    return "pothole" if row.size in HOLE_SIZES else row.size


def _ordered(rows: Sequence[Measured]) -> list[Measured]:
    """Sizes in their order, sensors in that of the run."""
    sensors = list(dict.fromkeys(row.sensor for row in rows))
    return sorted(rows, key=lambda row: (sensors.index(row.sensor), SIZES.index(row.size)))
