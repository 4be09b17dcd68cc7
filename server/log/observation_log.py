"""The log of everything that was decided, in an order that gives the same decisions: reports, operators' and own acts.

Each line carries, for every tile that it locked, the tile's `lock_seq` at that moment. Two lines that could touch the
same obstacle share a tile, so reading every tile's lines in ascending order repeats every decision.
"""

from __future__ import annotations

import heapq
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from pydantic import TypeAdapter
from sqlalchemy import RowMapping, Table, select, tuple_

from contract.history import OperatorAction
from contract.observation import ObservationReport, ReportResult
from server import rules
from server.errors import ServiceError
from server.ingesting.group import Opened
from server.ingesting.parcel import Parcel
from server.life.policy import Policy
from server.life.reach import reach_of
from server.storage import tables
from server.storage.audit import Order
from server.storage.database import Database

_BATCH = 500
_tiles = TypeAdapter(dict[int, int])
_action: TypeAdapter[OperatorAction] = TypeAdapter(OperatorAction)


@dataclass(frozen=True, slots=True)
class Line:
    """A report or an act, with the order in which its tiles were held."""

    at: datetime
    tiles: Mapping[int, int]
    row: RowMapping
    is_report: bool


class LogGapError(ServiceError):
    """A line is missing from the log, so that what follows cannot be decided as it was."""


async def in_order(database: Database, held: Mapping[int, int]) -> AsyncIterator[Line]:
    """All lines behind `held` (the last `lock_seq` of each tile that a checkpoint knows), in a repeatable order.

    Raises `LogGapError` when a line is missing.
    """
    last = dict(held)
    waiting: dict[tuple[int, int], Line] = {}
    async for line in _by_time(database):
        if line.tiles and all(seq <= held.get(tile, 0) for tile, seq in line.tiles.items()):
            continue
        ready: list[Line] = [line]
        while ready:
            item = ready.pop()
            if blocked := _first_not_yet(item, last):
                waiting[blocked] = item
                continue
            last.update(item.tiles)
            yield item
            ready += [
                waiting.pop(key) for key in ((tile, seq + 1) for tile, seq in item.tiles.items()) if key in waiting
            ]
    if waiting:
        tile, seq = min(waiting)
        raise LogGapError(f"the log has a gap: line {seq - 1} of tile {tile} is missing; begin with a later checkpoint")


def report_of(line: Line, policy: Policy) -> Opened:
    """A logged report, to be decided as it was."""
    message = ObservationReport.model_validate_json(line.row["body"])
    received_at, witness, key_id = line.row["received_at"], line.row["witness"], line.row["key_id"]
    item = Parcel(message, received_at, received_at, key_id, witness, line.row["body"])
    report = rules.Report(message, line.row["observed_at"], key_id, witness, trusted=not _was_distrusted(line.row))
    return Opened(item, report, reach_of(message, policy))


def order_of(line: Line) -> Order:
    """A logged act, to be carried out again."""
    kind, detail = line.row["kind"], line.row["detail"]
    members = {name: value for name, value in detail.items() if name not in ("before", "after")}
    deed = kind if kind in ("delete", "expire") else _action.validate_python({"action": kind, **members})
    return Order(line.row["obstacle_id"], deed, line.row["key_id"], line.row["request_id"], None)


def _first_not_yet(line: Line, last: Mapping[int, int]) -> tuple[int, int] | None:
    """The first of a line's tiles whose previous line has not been read yet."""
    return next((item for item in line.tiles.items() if last.get(item[0], 0) != item[1] - 1), None)


async def _by_time(database: Database) -> AsyncIterator[Line]:
    """Reports and acts by their time, which is nearly the order they were decided in."""
    reports = _lines(database, tables.report, "received_at", ("key_id", "report_id"), is_report=True)
    acts = _lines(database, tables.action, "at", ("id",), is_report=False)
    heads: list[tuple[datetime, int, Line, AsyncIterator[Line]]] = []
    for number, source in enumerate((reports, acts)):
        if (line := await anext(source, None)) is not None:
            heads.append((line.at, number, line, source))
    heapq.heapify(heads)
    while heads:
        _, number, line, source = heads[0]
        yield line
        following = await anext(source, None)
        if following is None:
            heapq.heappop(heads)
        else:
            heapq.heapreplace(heads, (following.at, number, following, source))


async def _lines(
    database: Database, table: Table, time: str, names: tuple[str, ...], *, is_report: bool
) -> AsyncIterator[Line]:
    key = tuple_(table.c[time], *(table.c[name] for name in names))
    after: tuple[Any, ...] | None = None
    while True:
        query = select(table).order_by(*key.clauses).limit(_BATCH)
        if after is not None:
            # The first condition is what the index by time can use.
            query = query.where(table.c[time] >= after[0], key > after)
        async with database.read() as connection:
            rows = (await connection.execute(query)).mappings().all()
        for row in rows:
            tiles = _tiles.validate_json(row["tiles"]) if is_report else {int(k): v for k, v in row["tiles"].items()}
            yield Line(row[time], tiles, row, is_report)
        if len(rows) < _BATCH:
            return
        after = tuple(rows[-1][name] for name in (time, *names))


def _was_distrusted(row: RowMapping) -> bool:
    result = ReportResult.model_validate_json(row["answer"])
    reasons = [item.reason for item in result.detections] + [item.why for item in result.inspections]
    return rules.DISTRUSTED in reasons
