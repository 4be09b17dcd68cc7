"""The decided state as a file: what a replay begins with when the log before it was pruned.

One JSON object a line, compressed: first a header, then a line for each row. Written beside its name and moved there
when it is complete and on the disk.
"""

from __future__ import annotations

import gzip
import json
import os
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TextIO
from uuid import UUID

from sqlalchemy import Column, Table, Uuid, select
from sqlalchemy.ext.asyncio import AsyncConnection

from server.errors import ServiceError
from server.storage import tables
from server.storage.database import Database
from server.storage.tables import UtcMicroseconds

FORMAT = "headsup-checkpoint-1"
_TABLES = (
    tables.tile,
    tables.obstacle,
    tables.obstacle_version,
    tables.witness,
    tables.creation,
    tables.vehicle_place,
)
_BATCH = 500


class CheckpointError(ServiceError):
    """The file is no checkpoint, or is cut off."""


async def save(database: Database, path: Path) -> int:
    """Write the state as one snapshot; the number of rows."""
    part = path.with_name(f".{path.name}.part")
    # Where witnesses were last is nobody else's business on this machine.
    with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "wb") as raw:
        with gzip.open(raw, "wt", encoding="utf-8", compresslevel=5) as file:
            file.write(json.dumps({"format": FORMAT, "taken_at": datetime.now(UTC).isoformat()}) + "\n")
            async with database.snapshot() as connection:
                count = sum([await _save_table(connection, table, file) for table in _TABLES])
            file.write(json.dumps({"rows": count}) + "\n")
        raw.flush()
        os.fsync(raw.fileno())
    part.replace(path)
    return count


async def load(path: Path, connection: AsyncConnection) -> dict[int, int]:
    """Put a checkpoint's rows into empty tables; the last `lock_seq` of every tile."""
    held: dict[int, int] = {}
    batch: dict[str, list[dict[str, Any]]] = {}
    count, promised = 0, None
    for line in _checked_lines(path):
        if "rows" in line:
            promised = line["rows"]
            break
        table = tables.metadata.tables[line["table"]]
        row = {column.name: _restored(column, line["row"].get(column.name)) for column in table.columns}
        batch.setdefault(table.name, []).append(row)
        count += 1
        if table is tables.tile:
            held[row["tile"]] = row["lock_seq"]
        if len(batch[table.name]) >= _BATCH:
            await _insert(connection, table.name, batch.pop(table.name))
    if promised != count:
        raise CheckpointError(f"{path} is cut off after {count} rows")
    for name, rows in batch.items():
        await _insert(connection, name, rows)
    return held


async def _save_table(connection: AsyncConnection, table: Table, file: TextIO) -> int:
    count = 0
    async with connection.stream(select(table).order_by(*table.primary_key.columns)) as rows:
        async for row in rows.mappings():
            values = {name: _plain(value) for name, value in row.items() if value is not None}
            file.write(json.dumps({"table": table.name, "row": values}) + "\n")
            count += 1
    return count


async def _insert(connection: AsyncConnection, name: str, rows: list[dict[str, Any]]) -> None:
    await connection.execute(tables.metadata.tables[name].insert(), rows)


def _checked_lines(path: Path) -> Iterator[dict[str, Any]]:
    try:
        with gzip.open(path, "rt", encoding="utf-8") as file:
            header = json.loads(next(file, "null"))
            if not isinstance(header, dict) or header.get("format") != FORMAT:
                raise CheckpointError(f"{path} is no checkpoint of this version ({FORMAT})")
            for text in file:
                yield json.loads(text)
    except (OSError, EOFError, ValueError) as error:
        raise CheckpointError(f"{path} cannot be read: {error}") from error


def _plain(value: Any) -> Any:
    if isinstance(value, datetime):
        return value.isoformat()
    return str(value) if isinstance(value, UUID) else value


def _restored(column: Column[Any], value: Any) -> Any:
    if value is None:
        return None
    if isinstance(column.type, UtcMicroseconds):
        return datetime.fromisoformat(value)
    return UUID(value) if isinstance(column.type, Uuid) else value
