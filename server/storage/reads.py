"""What a write transaction reads of many reports at once: arrays for PostgreSQL, numbered parameters for SQLite."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Protocol, TypeVar
from uuid import UUID

from sqlalchemy.ext.asyncio import AsyncConnection

from server.geometry.quadkey import merged, shard_of_tile
from server.life.reach import Reach
from server.storage import statements
from server.storage.executing import Executor, executor_of
from server.storage.rows import Row
from server.storage.statements import numbered, padded, range_values

ReportName = tuple[str, UUID]
"""The key under which a report was sent, and the id that the vehicle gave it."""

T = TypeVar("T")
# SQLite takes 32,766 parameters in a statement; a pair has three.
_MOST_PAIRS = 4_096


@dataclass(frozen=True, slots=True)
class Named:
    """Evidence of one witness about one obstacle, by the primary key of its row."""

    shard: int
    obstacle_id: UUID
    name: str


@dataclass(frozen=True, slots=True)
class Absent:
    """An obstacle with an open run of absences."""

    shard: int
    obstacle_id: UUID
    since: datetime


class Reads(Protocol):
    """Rows for many reports, by one statement or a few; of nothing, none."""

    async def tiles(self, wanted: Sequence[int]) -> Sequence[Row]:
        """Rows of tiles, locked in the order of `wanted`, which ascends."""
        ...

    async def answers(self, wanted: Sequence[ReportName]) -> Sequence[Row]:
        """Reports of those names that were answered before."""
        ...

    async def places(self, witnesses: Sequence[str]) -> Sequence[Row]:
        """Last places of witnesses."""
        ...

    async def obstacles(self, reaches: Sequence[Reach]) -> Sequence[Row]:
        """Obstacles near any of the reports, and those afar that are badly known or inspected; some of them twice."""
        ...

    async def named(self, wanted: Sequence[Named]) -> Sequence[Row]:
        """Evidence of those names."""
        ...

    async def since(self, absent: Sequence[Absent]) -> Sequence[Row]:
        """All evidence about obstacles since their first open absences."""
        ...


async def reads_of(connection: AsyncConnection) -> Reads:
    """The reads of a connection's transaction."""
    executor = await executor_of(connection)
    return SqliteReads(executor) if connection.dialect.name == "sqlite" else PostgresReads(executor)


class PostgresReads:
    """One statement for any number of tiles, names, ranges or obstacles."""

    def __init__(self, executor: Executor) -> None:
        self._executor = executor

    async def tiles(self, wanted: Sequence[int]) -> Sequence[Row]:
        """Rows of tiles, locked in the order of `wanted`, which ascends."""
        if not wanted:
            return ()
        values = {"shards": list(map(shard_of_tile, wanted)), "tiles": wanted}
        return await self._executor.rows(statements.tiles_for_update(), values)

    async def answers(self, wanted: Sequence[ReportName]) -> Sequence[Row]:
        """Reports of those names that were answered before."""
        if not wanted:
            return ()
        values = {"key_ids": [key for key, _ in wanted], "report_ids": [report for _, report in wanted]}
        return await self._executor.rows(statements.answers_to_arrays(), values)

    async def places(self, witnesses: Sequence[str]) -> Sequence[Row]:
        """Last places of witnesses."""
        return await self._executor.rows(statements.places_of_arrays(), {"names": witnesses}) if witnesses else ()

    async def obstacles(self, reaches: Sequence[Reach]) -> Sequence[Row]:
        """Obstacles near any of the reports, and those afar that are badly known or inspected; some of them twice."""
        near = merged(span for reach in reaches for span in reach.near_cells)
        far = merged(span for reach in reaches for span in reach.far)
        spans = {
            "lows": [low for low, _ in near + far],
            "highs": [high for _, high in near + far],
            "limits_m2": [-1.0] * len(near) + [reaches[0].well_known_m2] * len(far),
            "ids": _inspected(reaches),
        }
        return await self._executor.rows(statements.obstacles_reached(), spans)

    async def named(self, wanted: Sequence[Named]) -> Sequence[Row]:
        """Evidence of those names."""
        if not wanted:
            return ()
        values = _columns(wanted) | {"names": [item.name for item in wanted]}
        return await self._executor.rows(statements.evidence_of_arrays(), values)

    async def since(self, absent: Sequence[Absent]) -> Sequence[Row]:
        """All evidence about obstacles since their first open absences."""
        if not absent:
            return ()
        values = _columns(absent) | {"sinces": [item.since for item in absent]}
        return await self._executor.rows(statements.evidence_since_arrays(), values)


class SqliteReads:
    """Statements for so many tiles, names, ranges or obstacles, since SQLite has no arrays."""

    def __init__(self, executor: Executor) -> None:
        self._executor = executor

    async def tiles(self, wanted: Sequence[int]) -> Sequence[Row]:
        """Rows of tiles; the whole file is locked."""
        if not wanted:
            return ()
        tiles = padded(wanted)
        values = numbered("shard", [shard_of_tile(number) for number in tiles]) | numbered("tile", tiles)
        return await self._executor.rows(statements.tiles_held(len(tiles)), values)

    async def answers(self, wanted: Sequence[ReportName]) -> Sequence[Row]:
        """Reports of those names that were answered before."""
        if not wanted:
            return ()
        names = padded(wanted)
        values = numbered("key", [key for key, _ in names]) | numbered("report", [report for _, report in names])
        return await self._executor.rows(statements.answers_to(len(names)), values)

    async def places(self, witnesses: Sequence[str]) -> Sequence[Row]:
        """Last places of witnesses."""
        if not witnesses:
            return ()
        names = padded(witnesses)
        return await self._executor.rows(statements.places_of(len(names)), numbered("name", names))

    async def obstacles(self, reaches: Sequence[Reach]) -> Sequence[Row]:
        """Obstacles near any of the reports, and those afar that are badly known or inspected; some of them twice."""
        near = padded(merged(span for reach in reaches for span in reach.near_cells))
        far = padded(merged(span for reach in reaches for span in reach.far))
        inspected = padded(_inspected(reaches))
        values = range_values(far) | numbered("id", inspected) | {"limit_m2": reaches[0].well_known_m2}
        afar = await self._executor.rows(statements.obstacles_afar(len(far), len(inspected)), values)
        if not near:
            return afar
        return [*afar, *await self._executor.rows(statements.obstacles_in(len(near)), range_values(near))]

    async def named(self, wanted: Sequence[Named]) -> Sequence[Row]:
        """Evidence of those names."""
        found: list[Row] = []
        for chunk in _chunks(wanted):
            values = _numbered(chunk) | numbered("name", [item.name for item in chunk])
            found += await self._executor.rows(statements.evidence_of(len(chunk)), values)
        return found

    async def since(self, absent: Sequence[Absent]) -> Sequence[Row]:
        """All evidence about obstacles since their first open absences."""
        found: list[Row] = []
        for chunk in _chunks(absent):
            values = _numbered(chunk) | numbered("since", [item.since for item in chunk])
            found += await self._executor.rows(statements.evidence_since(len(chunk)), values)
        return found


def _chunks(about: Sequence[T]) -> Iterator[tuple[T, ...]]:
    return (padded(about[first : first + _MOST_PAIRS]) for first in range(0, len(about), _MOST_PAIRS))


def _inspected(reaches: Iterable[Reach]) -> list[UUID]:
    return sorted({identifier for reach in reaches for identifier in reach.inspected})


def _columns(about: Sequence[Named] | Sequence[Absent]) -> dict[str, Any]:
    return {"shards": [item.shard for item in about], "ids": [item.obstacle_id for item in about]}


def _numbered(about: Sequence[Named] | Sequence[Absent]) -> dict[str, Any]:
    shards, ids = [item.shard for item in about], [item.obstacle_id for item in about]
    return numbered("shard", shards) | numbered("id", ids)
