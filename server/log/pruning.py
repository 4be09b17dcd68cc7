"""Retention: what vehicles sent is kept for some time, and then only what became of it."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from sqlalchemy import delete, select, tuple_

from server.errors import ServiceError
from server.life.policy import Times
from server.log import checkpoint
from server.storage import tables
from server.storage.database import Database

# Short transactions: reports wait for none of them.
_BATCH = 1_000
# A place is only compared with the next report.
_PLACE_KEPT = timedelta(days=7)


class RetentionError(ServiceError):
    """The log is to be kept for too short a time."""


@dataclass(frozen=True, slots=True)
class Pruned:
    """Rows in the checkpoint, reports deleted, and vehicles whose last place was forgotten."""

    checkpointed: int
    reports: int
    places: int


async def prune(database: Database, keep: timedelta, path: Path, now: datetime, times: Times) -> Pruned:
    """Save a checkpoint, then delete reports received more than `keep` ago.

    A replay begins with the checkpoint. Raises `RetentionError` when reports would be forgotten while a vehicle may
    still repeat them.
    """
    if keep < times.oldest:
        raise RetentionError(f"keep at least {times.oldest.days} days: until then a report may be repeated")
    saved = await checkpoint.save(database, path)
    reports = 0
    while deleted := await _delete_reports(database, now - keep):
        reports += deleted
    async with database.write() as connection:
        gone = delete(tables.vehicle_place).where(tables.vehicle_place.c.observed_at < now - _PLACE_KEPT)
        places = (await connection.execute(gone)).rowcount
    return Pruned(saved, reports, places)


async def _delete_reports(database: Database, before: datetime) -> int:
    table = tables.report
    key = (table.c.key_id, table.c.report_id)
    async with database.write() as connection:
        old = (await connection.execute(select(*key).where(table.c.received_at < before).limit(_BATCH))).all()
        if old:
            await connection.execute(delete(table).where(tuple_(*key).in_([tuple(row) for row in old])))
    return len(old)
