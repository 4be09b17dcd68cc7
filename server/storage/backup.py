"""A copy of the embedded database while it is in use. PostgreSQL has `pg_dump`: see docs/operations.md."""

from __future__ import annotations

import os
import sqlite3
from contextlib import closing
from pathlib import Path

from sqlalchemy.engine import make_url

from server.errors import ServiceError


class BackupError(ServiceError):
    """The copy cannot be made, or is not sound."""


def backup(database_url: str, target: Path) -> int:
    """Copy a SQLite database as of one moment into a new file, durably; the file's size in bytes.

    Writers go on meanwhile: in WAL mode a reader, as the copy is, stops nobody. The file has keys' hashes and the
    secret of the witnesses' names, so only its owner may read it.
    """
    url = make_url(database_url)
    if url.get_backend_name() != "sqlite":
        raise BackupError("this is PostgreSQL: use pg_dump, as docs/operations.md shows")
    source = Path(url.database or "")
    if not source.is_file():
        raise BackupError(f"there is no database {source}")
    if target.exists():
        raise BackupError(f"{target} exists: name a new file, or move it away")
    part = target.with_name(f".{target.name}.part")
    try:
        _copy(source, part)
        part.rename(target)
    finally:
        part.unlink(missing_ok=True)
    _synchronise(target.parent)
    return target.stat().st_size


def _copy(source: Path, part: Path) -> None:
    os.close(os.open(part, os.O_CREAT | os.O_WRONLY | os.O_TRUNC, 0o600))
    try:
        with (
            closing(sqlite3.connect(f"{source.absolute().as_uri()}?mode=ro", uri=True)) as live,
            closing(sqlite3.connect(part)) as copy,
        ):
            # In one step: one of several would begin again after every write.
            live.backup(copy)
            # Then the copy is one file, without a log beside it.
            copy.execute("PRAGMA journal_mode=DELETE")
            (verdict,) = copy.execute("PRAGMA quick_check(1)").fetchone()
    except sqlite3.Error as error:
        raise BackupError(f"the copy failed: {error}") from None
    if verdict != "ok":
        raise BackupError(f"the database is damaged: {verdict}")
    _synchronise(part)


def _synchronise(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
