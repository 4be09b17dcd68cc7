"""Every query of the service's rule. One `Repository` works inside one transaction of the caller."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from uuid import UUID

from sqlalchemy import ColumnElement, and_, or_, select, text
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.ext.asyncio import AsyncConnection
from sqlalchemy.sql.dml import Insert

from contract.geometry import LatLon
from contract.observation import State
from contract.obstacle import ObstacleFeature
from server.geometry.quadkey import Ranges, cover, shard_of_tile
from server.life.identity import shard_of_id
from server.life.obstacle import Obstacle
from server.life.plausibility import LastPlace
from server.life.policy import Life
from server.storage import candidates, rows, served, tables
from server.storage.candidates import Asked
from server.storage.reads import ReportName, reads_of
from server.storage.working_set import Tile, WorkingSet


@dataclass(frozen=True, slots=True)
class Answered:
    """What was sent and answered under a report's name."""

    body_sha256: str
    answer: str


class Repository:
    """Reads obstacles, their evidence and the observation log; `server.storage.writing` writes what was decided."""

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

    async def working_set(self, held: dict[int, Tile], asked: Sequence[Asked]) -> WorkingSet:
        """All obstacles that reports could concern, removed ones too, with the evidence that decisions may need."""
        return WorkingSet(held, *await candidates.read(await reads_of(self._connection), asked), self._life)

    async def near(self, centre: LatLon, radius_m: float, now: datetime) -> tuple[ObstacleFeature, ...]:
        """Live obstacles in the cells of a circle (a little more than the circle) that have not expired."""
        table = tables.obstacle
        is_served = and_(table.c.state != State.REMOVED.value, table.c.expires_at > now)
        inside = _in_cells(cover(centre, radius_m))
        query = select(*served.SERVED).where(inside, is_served).order_by(table.c.id)
        return await served.read(self._connection, query, self._life)

    async def obstacle(self, identifier: UUID) -> Obstacle | None:
        """An obstacle by id, also a removed one."""
        table = tables.obstacle
        query = select(table).where(table.c.shard == shard_of_id(identifier), table.c.id == identifier)
        found = (await self._connection.execute(query)).mappings().one_or_none()
        return None if found is None else rows.obstacle_of(found)

    async def answered(self, names: Iterable[ReportName]) -> dict[ReportName, Answered]:
        """What was answered before, by the reports' names."""
        found = await (await reads_of(self._connection)).answers(sorted(set(names)))
        return {(row["key_id"], row["report_id"]): Answered(row["body_sha256"], row["answer"]) for row in found}

    async def last_places(self, witnesses: Iterable[str]) -> dict[str, LastPlace]:
        """Where witnesses were when they last reported."""
        found = await (await reads_of(self._connection)).places(sorted(set(witnesses)))
        return {row["witness"]: LastPlace(rows.position_of(row), row["sd_m"], row["observed_at"]) for row in found}

    async def secret(self, name: str, fresh: str) -> str:
        """A secret of this installation; `fresh` becomes it when there is none yet."""
        await self._connection.execute(self._insert_if_missing("secret").values(name=name, value=fresh))
        query = select(tables.secret.c.value).where(tables.secret.c.name == name)
        return str((await self._connection.execute(query)).scalar_one())

    async def _held(self, tiles: list[int]) -> dict[int, Tile]:
        found = await (await reads_of(self._connection)).tiles(tiles)
        return {row["tile"]: Tile(row["version"], row["lock_seq"]) for row in found}

    def _insert_if_missing(self, name: str) -> Insert:
        table = tables.metadata.tables[name]
        if self._connection.dialect.name == "sqlite":
            return sqlite.insert(table).on_conflict_do_nothing()
        return postgresql.insert(table).on_conflict_do_nothing()


def _in_cells(ranges: Ranges) -> ColumnElement[bool]:
    cell = tables.obstacle.c.cell
    return or_(*(cell.between(low, high) for low, high in ranges))
