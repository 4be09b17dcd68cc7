"""Every query of the service. One `Repository` works inside one transaction of the caller."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from uuid import UUID

from sqlalchemy import ColumnElement, RowMapping, and_, or_, select, text, update
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.ext.asyncio import AsyncConnection
from sqlalchemy.sql.dml import Insert

from contract.geometry import LatLon
from contract.observation import State
from server import rows, tables
from server.identity import shard_of_id
from server.obstacle import Obstacle, Witness
from server.policy import Life
from server.quadkey import cell_of, cover, shard_of_tile, tile_of_cell


@dataclass(frozen=True, slots=True)
class LoggedReport:
    """A line of the observation log."""

    key_id: str
    report_id: UUID
    body_sha256: str
    witness: str
    observed_at: datetime
    received_at: datetime
    body: str
    answer: str
    tiles: Sequence[tuple[int, int]]


class Repository:
    """Reads and writes obstacles, their evidence and history, events, and the observation log."""

    def __init__(self, connection: AsyncConnection, life: Life) -> None:
        self._connection = connection
        self._life = life

    async def ping(self) -> None:
        """Fail if the database does not answer."""
        await self._connection.execute(text("SELECT 1"))

    async def lock(self, tiles: Iterable[int]) -> list[tuple[int, int]]:
        """Take the tiles for this transaction, in ascending order; what could match is read after it.

        Returns each tile with its new `lock_seq`, the order in which transactions held it.
        """
        table, taken_in_order = tables.tile, []
        for tile in sorted(tiles):
            shard = shard_of_tile(tile)
            here = and_(table.c.shard == shard, table.c.tile == tile)
            taken = update(table).where(here).values(lock_seq=table.c.lock_seq + 1).returning(table.c.lock_seq)
            lock_seq = (await self._connection.execute(taken)).scalar_one_or_none()
            if lock_seq is None:
                new = {"shard": shard, "tile": tile, "version": 0, "lock_seq": 0}
                await self._connection.execute(self._insert_if_missing("tile").values(new))
                lock_seq = (await self._connection.execute(taken)).scalar_one()
            taken_in_order.append((tile, int(lock_seq)))
        return taken_in_order

    async def candidates(self, centre: LatLon, radius_m: float, witness: str) -> tuple[Obstacle, ...]:
        """All obstacles in the cells of a circle, removed ones too, with the evidence a decision may need."""
        found = await self._obstacle_rows(self._in_cover(centre, radius_m))
        evidence = await self._evidence([row["id"] for row in found], witness)
        return tuple(rows.obstacle_of(row, evidence.get(row["id"], ())) for row in found)

    async def near(self, centre: LatLon, radius_m: float, now: datetime) -> tuple[Obstacle, ...]:
        """Live obstacles in the cells of a circle (a little more than the circle) that have not expired."""
        table = tables.obstacle
        is_served = and_(table.c.state != State.REMOVED.value, table.c.expires_at > now)
        return tuple(map(rows.obstacle_of, await self._obstacle_rows(self._in_cover(centre, radius_m), is_served)))

    async def obstacle(self, identifier: UUID) -> Obstacle | None:
        """An obstacle by id, also a removed one."""
        table = tables.obstacle
        found = await self._obstacle_rows(table.c.shard == shard_of_id(identifier), table.c.id == identifier)
        return rows.obstacle_of(found[0]) if found else None

    async def create(self, obstacle: Obstacle) -> None:
        """Write a new obstacle and its evidence."""
        await self._connection.execute(tables.obstacle.insert().values(rows.row_of(obstacle, self._life)))
        await self._put_evidence(obstacle, obstacle.evidence)

    async def replace(self, before: Obstacle, after: Obstacle, now: datetime) -> None:
        """Write an obstacle's new value; a version that ends goes into the history."""
        table = tables.obstacle
        if after.version != before.version:
            await self._keep_version(before, now)
        values = {name: value for name, value in rows.row_of(after, self._life).items() if name not in ("shard", "id")}
        here = and_(table.c.shard == after.shard, table.c.id == after.id)
        await self._connection.execute(update(table).where(here).values(values))
        await self._put_evidence(after, [item for item in after.evidence if item not in before.evidence])

    async def append_event(self, obstacle: Obstacle, body: str, now: datetime) -> int:
        """Write an event with the next sequence number of the obstacle's tile, which is the tile's new version."""
        tile = tile_of_cell(cell_of(obstacle.place.position))
        shard, table = shard_of_tile(tile), tables.tile
        here = and_(table.c.shard == shard, table.c.tile == tile)
        advance = update(table).where(here).values(version=table.c.version + 1).returning(table.c.version)
        seq = (await self._connection.execute(advance)).scalar_one()
        line = {"shard": shard, "tile": tile, "seq": seq, "obstacle_id": obstacle.id, "body": body, "written_at": now}
        await self._connection.execute(tables.event.insert().values(line))
        return int(seq)

    async def logged(self, key_id: str, report_id: UUID) -> LoggedReport | None:
        """What was sent and answered under a report id."""
        table = tables.report
        query = select(table).where(table.c.key_id == key_id, table.c.report_id == report_id)
        row = (await self._connection.execute(query)).mappings().one_or_none()
        return None if row is None else LoggedReport(**row)

    async def log(self, line: LoggedReport) -> None:
        """Append to the observation log; the primary key refuses a second line of one report id."""
        values = {column.name: getattr(line, column.name) for column in tables.report.columns}
        await self._connection.execute(tables.report.insert().values(values))

    async def secret(self, name: str, fresh: str) -> str:
        """A secret of this installation; `fresh` becomes it when there is none yet."""
        await self._connection.execute(self._insert_if_missing("secret").values(name=name, value=fresh))
        query = select(tables.secret.c.value).where(tables.secret.c.name == name)
        return str((await self._connection.execute(query)).scalar_one())

    async def _obstacle_rows(self, *conditions: ColumnElement[bool]) -> Sequence[RowMapping]:
        query = select(tables.obstacle).where(*conditions).order_by(tables.obstacle.c.id)
        return (await self._connection.execute(query)).mappings().all()

    async def _evidence(self, obstacle_ids: list[UUID], name: str) -> dict[UUID, list[Witness]]:
        """Evidence of the named witness, and all since an obstacle's first open absence."""
        obstacle, witness = tables.obstacle, tables.witness
        query = (
            select(witness)
            .join(obstacle, and_(obstacle.c.shard == witness.c.shard, obstacle.c.id == witness.c.obstacle_id))
            .where(obstacle.c.shard.in_(sorted(set(map(shard_of_id, obstacle_ids)))), obstacle.c.id.in_(obstacle_ids))
            .where(or_(witness.c.name == name, witness.c.latest_at >= obstacle.c.absent_since))
        )
        evidence: dict[UUID, list[Witness]] = {}
        for row in (await self._connection.execute(query)).mappings():
            evidence.setdefault(row["obstacle_id"], []).append(rows.witness_of(row))
        return evidence

    async def _put_evidence(self, obstacle: Obstacle, evidence: Iterable[Witness]) -> None:
        table = tables.witness
        for witness in evidence:
            values = rows.witness_row(obstacle, witness)
            here = and_(
                table.c.shard == obstacle.shard, table.c.obstacle_id == obstacle.id, table.c.name == witness.name
            )
            if (await self._connection.execute(update(table).where(here).values(values))).rowcount == 0:
                await self._connection.execute(table.insert().values(values))

    async def _keep_version(self, before: Obstacle, now: datetime) -> None:
        line = {
            "shard": before.shard,
            "obstacle_id": before.id,
            "version": before.version,
            "shape": rows.shape_json(before.shape),
            "replaced_at": now,
        }
        await self._connection.execute(tables.obstacle_version.insert().values(line))

    def _in_cover(self, centre: LatLon, radius_m: float) -> ColumnElement[bool]:
        cell = tables.obstacle.c.cell
        return or_(*(cell.between(low, high) for low, high in cover(centre, radius_m)))

    def _insert_if_missing(self, name: str) -> Insert:
        table = tables.metadata.tables[name]
        if self._connection.dialect.name == "sqlite":
            return sqlite.insert(table).on_conflict_do_nothing()
        return postgresql.insert(table).on_conflict_do_nothing()
