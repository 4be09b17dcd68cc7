"""Every query of the service's rule. One `Repository` works inside one transaction of the caller."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import TypeVar
from uuid import UUID

from sqlalchemy import ColumnElement, RowMapping, and_, or_, select, text, tuple_
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.ext.asyncio import AsyncConnection
from sqlalchemy.sql.dml import Insert

from contract.geometry import LatLon
from contract.observation import State
from server import rows, tables
from server.identity import shard_of_id
from server.obstacle import Obstacle
from server.policy import Life
from server.quadkey import Ranges, cover, merged, shard_of_tile
from server.working_set import Evidence, Tile, WorkingSet, with_evidence

Area = tuple[LatLon, float]
ReportName = tuple[str, UUID]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Answered:
    """What was sent and answered under a report's name."""

    body_sha256: str
    answer: str


class Repository:
    """Reads obstacles, their evidence and the observation log; `server.writing` writes what was decided."""

    def __init__(self, connection: AsyncConnection, life: Life) -> None:
        self._connection = connection
        self._life = life

    async def ping(self) -> None:
        """Fail if the database does not answer."""
        await self._connection.execute(text("SELECT 1"))

    async def hold(self, tiles: Iterable[int]) -> dict[int, Tile]:
        """Take the tiles for this transaction, in ascending order; what could match is read after it."""
        wanted = sorted(set(tiles))
        held = await self._held(wanted)
        if missing := [number for number in wanted if number not in held]:
            new = [{"shard": shard_of_tile(number), "tile": number, "version": 0, "lock_seq": 0} for number in missing]
            await self._connection.execute(self._insert_if_missing("tile"), new)
            held = await self._held(wanted)
        return held

    async def working_set(self, held: dict[int, Tile], areas: Sequence[Area], witnesses: Iterable[str]) -> WorkingSet:
        """All obstacles in the cells of circles, removed ones too, with the evidence that decisions may need."""
        ranges = merged(span for centre, radius_m in areas for span in cover(centre, radius_m))
        if not ranges:
            return WorkingSet(held, (), {}, self._life)
        found = [rows.obstacle_of(row) for row in await self._obstacle_rows(_in_cells(ranges))]
        evidence = await self._evidence(ranges, sorted(set(witnesses))) if found else {}
        return WorkingSet(held, with_evidence(found, evidence), evidence, self._life)

    async def near(self, centre: LatLon, radius_m: float, now: datetime) -> tuple[Obstacle, ...]:
        """Live obstacles in the cells of a circle (a little more than the circle) that have not expired."""
        table = tables.obstacle
        is_served = and_(table.c.state != State.REMOVED.value, table.c.expires_at > now)
        inside = _in_cells(cover(centre, radius_m))
        return tuple(map(rows.obstacle_of, await self._obstacle_rows(inside, is_served)))

    async def obstacle(self, identifier: UUID) -> Obstacle | None:
        """An obstacle by id, also a removed one."""
        table = tables.obstacle
        found = await self._obstacle_rows(table.c.shard == shard_of_id(identifier), table.c.id == identifier)
        return rows.obstacle_of(found[0]) if found else None

    async def answered(self, names: Iterable[ReportName]) -> dict[ReportName, Answered]:
        """What was answered before, by the reports' names."""
        table = tables.report
        wanted = padded(sorted(set(names)))
        if not wanted:
            return {}
        query = select(table.c.key_id, table.c.report_id, table.c.body_sha256, table.c.answer).where(
            tuple_(table.c.key_id, table.c.report_id).in_(wanted)
        )
        found = await self._connection.execute(query)
        return {(row.key_id, row.report_id): Answered(row.body_sha256, row.answer) for row in found}

    async def secret(self, name: str, fresh: str) -> str:
        """A secret of this installation; `fresh` becomes it when there is none yet."""
        await self._connection.execute(self._insert_if_missing("secret").values(name=name, value=fresh))
        query = select(tables.secret.c.value).where(tables.secret.c.name == name)
        return str((await self._connection.execute(query)).scalar_one())

    async def _held(self, tiles: list[int]) -> dict[int, Tile]:
        if not tiles:
            return {}
        table = tables.tile
        shards = sorted({shard_of_tile(number) for number in tiles})
        query = (
            select(table.c.tile, table.c.version, table.c.lock_seq)
            .where(table.c.shard.in_(padded(shards)), table.c.tile.in_(padded(tiles)))
            .order_by(table.c.shard, table.c.tile)
            .with_for_update()
        )
        return {row.tile: Tile(row.version, row.lock_seq) for row in await self._connection.execute(query)}

    async def _obstacle_rows(self, *conditions: ColumnElement[bool]) -> Sequence[RowMapping]:
        query = select(tables.obstacle).where(*conditions).order_by(tables.obstacle.c.id)
        return (await self._connection.execute(query)).mappings().all()

    async def _evidence(self, ranges: Ranges, names: list[str]) -> Evidence:
        """Evidence of the named witnesses, and all since an obstacle's first open absence."""
        obstacle, witness = tables.obstacle, tables.witness
        query = (
            select(witness)
            .join(obstacle, and_(obstacle.c.shard == witness.c.shard, obstacle.c.id == witness.c.obstacle_id))
            .where(_in_cells(ranges))
            .where(or_(witness.c.name.in_(padded(names)), witness.c.latest_at >= obstacle.c.absent_since))
        )
        found = (await self._connection.execute(query)).mappings()
        return {(row["obstacle_id"], row["name"]): rows.witness_of(row) for row in found}

    def _insert_if_missing(self, name: str) -> Insert:
        table = tables.metadata.tables[name]
        if self._connection.dialect.name == "sqlite":
            return sqlite.insert(table).on_conflict_do_nothing()
        return postgresql.insert(table).on_conflict_do_nothing()


def padded(values: Sequence[T]) -> list[T]:
    """Values repeated up to a power of two: lists of any length make only a few different statements to prepare."""
    if not values:
        return []
    size = 1 << (len(values) - 1).bit_length()
    return [*values, *[values[-1]] * (size - len(values))]


def _in_cells(ranges: Ranges) -> ColumnElement[bool]:
    cell = tables.obstacle.c.cell
    return or_(*(cell.between(low, high) for low, high in padded(ranges)))
