"""Reads what the reports of one transaction could concern: obstacles, and the evidence that their decisions need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from uuid import UUID

from server.geometry.cell_index import CellIndex
from server.life.obstacle import Obstacle, Witness
from server.life.reach import Reach
from server.storage import rows
from server.storage.reads import Absent, Named, Reads
from server.storage.rows import Row
from server.storage.working_set import Evidence


@dataclass(frozen=True, slots=True)
class Asked:
    """Where a report could find obstacles, and whose evidence about them it needs."""

    reach: Reach
    witness: str


async def read(reads: Reads, asked: Sequence[Asked]) -> tuple[list[Obstacle], Evidence]:
    """All obstacles that any of the reports could concern, removed ones too, and the evidence about them.

    That is: of each report's witness about what lies in the report's reach, and all since an obstacle's first open
    absence.
    """
    reaches = [item.reach for item in asked if item.reach.far]
    if not reaches:
        return [], {}
    # What is near one report may lie afar of another.
    found = {row["id"]: row for row in await reads.obstacles(reaches)}
    reports_of = _reports_of(found, asked)
    evidence = await _evidence(reads, found, reports_of)
    by_obstacle: dict[UUID, list[Witness]] = {}
    for (identifier, _), witness in evidence.items():
        by_obstacle.setdefault(identifier, []).append(witness)
    return [rows.obstacle_of(found[key], by_obstacle.get(key, ())) for key in reports_of], evidence


def _reports_of(found: dict[UUID, Row], asked: Sequence[Asked]) -> dict[UUID, list[Asked]]:
    """The reports with each obstacle in their cells, of obstacles that at least one of them concerns.

    All of them: what one report moves may come to concern another.
    """
    index = CellIndex((row["cell"], row["id"]) for row in found.values())
    position_of = {identifier: rows.position_of(row) for identifier, row in found.items()}
    around: dict[UUID, list[Asked]] = {}
    concerned: set[UUID] = set()
    for item in asked:
        for identifier in index.within(item.reach.far):
            around.setdefault(identifier, []).append(item)
            if identifier in concerned:
                continue
            row = found[identifier]
            if item.reach.concerns(identifier, position_of[identifier], row["east_m2"] + row["north_m2"]):
                concerned.add(identifier)
    return {identifier: around[identifier] for identifier in around if identifier in concerned}


async def _evidence(reads: Reads, found: dict[UUID, Row], reports_of: dict[UUID, list[Asked]]) -> Evidence:
    named = {
        Named(found[identifier]["shard"], identifier, item.witness): None
        for identifier, reports in reports_of.items()
        for item in reports
    }
    rows_found = [found[identifier] for identifier in reports_of]
    absent = [
        Absent(row["shard"], row["id"], row["absent_since"]) for row in rows_found if row["absent_since"] is not None
    ]
    lines = [*await reads.named(list(named)), *await reads.since(absent)]
    return {(row["obstacle_id"], row["name"]): rows.witness_of(row) for row in lines}
