"""The database's schema: which revision it is at, and bringing it to this version's by Alembic."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib.resources import as_file, files

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, func, inspect, select

from server.errors import SchemaOutOfDateError, ServiceError
from server.storage.database import Database

# Any number, as long as all versions have the same: "HUDB" in ASCII.
_MIGRATING = 0x48554442


class UnknownRevisionError(ServiceError):
    """There is no such revision to go back to."""


async def upgrade(database: Database) -> str:
    """Bring the schema to this version's revision, which is returned; harmless when it already is, or just comes to be.

    Of several at once the others wait for the first, and find nothing left to do. Raises `SchemaOutOfDateError` when
    the schema is a later version's.
    """
    async with database.write() as connection:
        current = await connection.run_sync(_current_revision)
        if not _is_known(current):
            raise SchemaOutOfDateError(f"the database's schema is at {current}: {remedy(current)}")
        await connection.run_sync(_migrate, command.upgrade, "head")
    return head_revision()


async def downgrade(database: Database, revision: str) -> str:
    """Take the schema back to an earlier revision, which is returned. Raises `UnknownRevisionError`."""
    current = await current_revision(database)
    earlier = [name for name, _ in revisions()]
    if revision not in earlier or current not in earlier or earlier.index(revision) > earlier.index(current):
        raise UnknownRevisionError(f"{revision!r} is no revision before {current}: see `headsup db status`")
    async with database.write() as connection:
        await connection.run_sync(_migrate, command.downgrade, revision)
    return revision


async def current_revision(database: Database) -> str | None:
    """The revision that the database is at; None when it has no schema of ours."""
    async with database.read() as connection:
        return await connection.run_sync(_current_revision)


async def prepare(database: Database) -> None:
    """Give a fresh SQLite file its schema; refuse any other that is not this version's."""
    async with database.read() as connection:
        is_fresh = await connection.run_sync(is_empty)
    if is_fresh and database.is_sqlite:
        await upgrade(database)
    await check(database)


async def check(database: Database) -> None:
    """Refuse a schema that is not this version's."""
    current = await current_revision(database)
    if current != head_revision():
        raise SchemaOutOfDateError(
            f"the database's schema is at {current or 'no revision'}, this version needs {head_revision()}: "
            f"{remedy(current)}"
        )


def remedy(current: str | None) -> str:
    """What to do about a schema that is not this version's."""
    if _is_known(current):
        return "run `headsup db upgrade`"
    return f"a later version made it: install that one, or run its `headsup db downgrade {head_revision()}`"


@cache
def head_revision() -> str:
    """The revision that this version needs."""
    with as_file(files("migrations")) as folder:
        head = ScriptDirectory(str(folder)).get_current_head()
    assert head is not None  # noqa: S101  # the migrations are part of the package
    return head


def revisions() -> list[tuple[str, str]]:
    """All revisions with what each is for, the first one first."""
    with as_file(files("migrations")) as folder:
        scripts = list(ScriptDirectory(str(folder)).walk_revisions())
    return [(script.revision, script.doc) for script in reversed(scripts)]


def _is_known(revision: str | None) -> bool:
    return revision is None or revision in [name for name, _ in revisions()]


def _migrate(connection: Connection, move: Callable[[Config, str], None], revision: str) -> None:
    if connection.dialect.name == "postgresql":
        # Until the transaction ends. SQLite's transactions that write wait for each other anyway.
        connection.execute(select(func.pg_advisory_xact_lock(_MIGRATING)))
    with as_file(files("migrations")) as folder:
        config = Config()
        config.set_main_option("script_location", str(folder).replace("%", "%%"))
        config.attributes["connection"] = connection
        move(config, revision)


def is_empty(connection: Connection) -> bool:
    """Whether the database has no tables at all."""
    return not inspect(connection).get_table_names()


def _current_revision(connection: Connection) -> str | None:
    return MigrationContext.configure(connection).get_current_revision()
