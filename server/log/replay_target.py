"""Where a replay goes: a database that is whole, or is not there."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from sqlalchemy.engine import make_url

from server.errors import ServiceError
from server.log.replay import ReplayError
from server.storage import schema
from server.storage.database import Database


class HalfMadeError(ServiceError):
    """A replay failed and could not take back what it had written."""


@asynccontextmanager
async def replay_target(url: str) -> AsyncIterator[Database]:
    """A database with this version's schema to replay into within the block.

    A file of SQLite gets its name when the block has ended well, and is gone otherwise. Raises `ReplayError` when there
    is such a file already, `HalfMadeError` when the block raises on PostgreSQL, whose databases are not ours to drop.
    """
    parsed = make_url(url)
    if parsed.get_backend_name() == "sqlite":
        async with _named_when_whole(Path(parsed.database or "")) as part:
            yield await _with_schema(part)
        return
    database = Database.open(url)
    try:
        yield await _with_schema(database)
    except ReplayError:
        raise
    except Exception as error:
        raise HalfMadeError(
            "the replay failed, and its target is half made: drop that database, and replay into a fresh one"
        ) from error
    finally:
        await database.close()


@asynccontextmanager
async def _named_when_whole(path: Path) -> AsyncIterator[Database]:
    part = _part_of(path)
    database = Database.open(f"sqlite+aiosqlite:///{part}")
    try:
        try:
            yield database
        finally:
            # The last connection's end puts the log into the file.
            await database.close()
        part.rename(path)
    finally:
        _remove(part)


def _part_of(path: Path) -> Path:
    if path.exists():
        raise ReplayError(f"{path} exists: name a new file, or move it away")
    part = path.with_name(f".{path.name}.part")
    # What a killed replay has left.
    _remove(part)
    return part


def _remove(path: Path) -> None:
    for end in ("", "-wal", "-shm"):
        path.with_name(path.name + end).unlink(missing_ok=True)


async def _with_schema(database: Database) -> Database:
    async with database.read() as connection:
        is_empty = await connection.run_sync(schema.is_empty)
    # Whatever is in it already is not ours to upgrade.
    await (schema.upgrade(database) if is_empty else schema.check(database))
    return database
