"""Reads what the reports of one transaction could concern: obstacles, and the evidence that their decisions need."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, TypeVar
from uuid import UUID

from sqlalchemy import RowMapping, Select
from sqlalchemy.ext.asyncio import AsyncConnection

from contract.geometry import LatLon
from server.geometry.cell_index import CellIndex
from server.geometry.quadkey import merged
from server.life.obstacle import Obstacle, Witness
from server.life.reach import Reach
from server.storage import rows
from server.storage.statements import (
    evidence_of,
    evidence_of_arrays,
    evidence_since,
    evidence_since_arrays,
    numbered,
    obstacles_afar,
    obstacles_in,
    obstacles_reached,
    padded,
    range_values,
)
from server.storage.working_set import Evidence

T = TypeVar("T")
# SQLite takes 32,766 parameters in a statement; a pair has three.
_MOST_PAIRS = 4_096


@dataclass(frozen=True, slots=True)
class Asked:
    """Where a report could find obstacles, and whose evidence about them it needs."""

    reach: Reach
    witness: str


@dataclass(frozen=True, slots=True)
class _Named:
    """Evidence of one witness about one obstacle, by the primary key of its row."""

    shard: int
    obstacle_id: UUID
    name: str


@dataclass(frozen=True, slots=True)
class _Absent:
    """An obstacle with an open run of absences."""

    shard: int
    obstacle_id: UUID
    since: datetime


async def read(connection: AsyncConnection, asked: Sequence[Asked]) -> tuple[list[Obstacle], Evidence]:
    """All obstacles that any of the reports could concern, removed ones too, and the evidence about them.

    That is: of each report's witness about what lies in the report's reach, and all since an obstacle's first open
    absence.
    """
    reading = _SqliteReading(connection) if connection.dialect.name == "sqlite" else _PostgresReading(connection)
    reaches = [item.reach for item in asked if item.reach.far]
    if not reaches:
        return [], {}
    # What is near one report may lie afar of another.
    found = {row["id"]: row for row in await reading.obstacles(reaches)}
    reports_of = _reports_of(found, asked)
    evidence = await _evidence(reading, found, reports_of)
    by_obstacle: dict[UUID, list[Witness]] = {}
    for (identifier, _), witness in evidence.items():
        by_obstacle.setdefault(identifier, []).append(witness)
    return [rows.obstacle_of(found[key], by_obstacle.get(key, ())) for key in reports_of], evidence


def _reports_of(found: dict[UUID, RowMapping], asked: Sequence[Asked]) -> dict[UUID, list[Asked]]:
    """The reports with each obstacle in their cells, of obstacles that at least one of them concerns.

    All of them: what one report moves may come to concern another.
    """
    index = CellIndex((row["cell"], row["id"]) for row in found.values())
    around: dict[UUID, list[Asked]] = {}
    concerned: set[UUID] = set()
    for item in asked:
        for identifier in index.within(item.reach.far):
            around.setdefault(identifier, []).append(item)
            if identifier not in concerned and _concerns(item.reach, found[identifier]):
                concerned.add(identifier)
    return {identifier: around[identifier] for identifier in around if identifier in concerned}


def _concerns(reach: Reach, row: RowMapping) -> bool:
    position = LatLon(latitude_deg=row["latitude_deg"], longitude_deg=row["longitude_deg"])
    return reach.concerns(row["id"], position, row["east_m2"] + row["north_m2"])


async def _evidence(reading: _Reading, found: dict[UUID, RowMapping], reports_of: dict[UUID, list[Asked]]) -> Evidence:
    named = {
        _Named(found[identifier]["shard"], identifier, item.witness): None
        for identifier, reports in reports_of.items()
        for item in reports
    }
    rows_found = [found[identifier] for identifier in reports_of]
    absent = [
        _Absent(row["shard"], row["id"], row["absent_since"]) for row in rows_found if row["absent_since"] is not None
    ]
    lines = [*await reading.named(list(named)), *await reading.since(absent)]
    return {(row["obstacle_id"], row["name"]): rows.witness_of(row) for row in lines}


class _PostgresReading:
    """One statement for any number of ranges, obstacles and witnesses."""

    def __init__(self, connection: AsyncConnection) -> None:
        self._connection = connection

    async def obstacles(self, reaches: Sequence[Reach]) -> Sequence[RowMapping]:
        near = merged(span for reach in reaches for span in reach.near_cells)
        far = merged(span for reach in reaches for span in reach.far)
        spans = {
            "lows": [low for low, _ in near + far],
            "highs": [high for _, high in near + far],
            "limits_m2": [-1.0] * len(near) + [reaches[0].well_known_m2] * len(far),
            "ids": _inspected(reaches),
        }
        return await _rows(self._connection, obstacles_reached(), spans)

    async def named(self, wanted: Sequence[_Named]) -> Sequence[RowMapping]:
        if not wanted:
            return ()
        values = _columns(wanted) | {"names": [item.name for item in wanted]}
        return await _rows(self._connection, evidence_of_arrays(), values)

    async def since(self, absent: Sequence[_Absent]) -> Sequence[RowMapping]:
        if not absent:
            return ()
        values = _columns(absent) | {"sinces": [item.since for item in absent]}
        return await _rows(self._connection, evidence_since_arrays(), values)


class _SqliteReading:
    """Statements for so many ranges, obstacles and witnesses, since SQLite has no arrays."""

    def __init__(self, connection: AsyncConnection) -> None:
        self._connection = connection

    async def obstacles(self, reaches: Sequence[Reach]) -> Sequence[RowMapping]:
        near = padded(merged(span for reach in reaches for span in reach.near_cells))
        far = padded(merged(span for reach in reaches for span in reach.far))
        inspected = padded(_inspected(reaches))
        values = range_values(far) | numbered("id", inspected) | {"limit_m2": reaches[0].well_known_m2}
        afar = await _rows(self._connection, obstacles_afar(len(far), len(inspected)), values)
        if not near:
            return afar
        return [*afar, *await _rows(self._connection, obstacles_in(len(near)), range_values(near))]

    async def named(self, wanted: Sequence[_Named]) -> Sequence[RowMapping]:
        found: list[RowMapping] = []
        for chunk in _chunks(wanted):
            values = _numbered(chunk) | numbered("name", [item.name for item in chunk])
            found += await _rows(self._connection, evidence_of(len(chunk)), values)
        return found

    async def since(self, absent: Sequence[_Absent]) -> Sequence[RowMapping]:
        found: list[RowMapping] = []
        for chunk in _chunks(absent):
            values = _numbered(chunk) | numbered("since", [item.since for item in chunk])
            found += await _rows(self._connection, evidence_since(len(chunk)), values)
        return found


_Reading = _PostgresReading | _SqliteReading


async def _rows(connection: AsyncConnection, query: Select[Any], values: dict[str, Any]) -> Sequence[RowMapping]:
    found: Sequence[RowMapping] = (await connection.execute(query, values)).mappings().all()
    return found


def _chunks(about: Sequence[T]) -> Iterator[tuple[T, ...]]:
    return (padded(about[first : first + _MOST_PAIRS]) for first in range(0, len(about), _MOST_PAIRS))


def _inspected(reaches: Iterable[Reach]) -> list[UUID]:
    return sorted({identifier for reach in reaches for identifier in reach.inspected})


def _columns(about: Sequence[_Named] | Sequence[_Absent]) -> dict[str, Any]:
    return {"shards": [item.shard for item in about], "ids": [item.obstacle_id for item in about]}


def _numbered(about: Sequence[_Named] | Sequence[_Absent]) -> dict[str, Any]:
    shards, ids = [item.shard for item in about], [item.obstacle_id for item in about]
    return numbered("shard", shards) | numbered("id", ids)
