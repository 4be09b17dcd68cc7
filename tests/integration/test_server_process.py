"""The server as its own process: the commands, durability, and refusals in one line."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from uuid import uuid4

import httpx
import pytest
from sqlalchemy import create_engine, text
from typer import Typer
from typer.testing import CliRunner, Result

from contract.observation import ObservationBatch, ObservationBatchResult
from headsup.database_commands import db_app
from headsup.key_commands import keys_app
from headsup.policy_command import policy_app
from headsup.server_commands import serve
from tests.integration.serving import served
from tests.unit.server.making import HOUR, detection, message

MINUTE = r"20\d\d-\d\d-\d\dT\d\d:\d\dZ"
PROGRAM = "from headsup.server_commands import serve; import typer; typer.run(serve)"


@pytest.fixture
def url(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    url = f"sqlite+aiosqlite:///{tmp_path}/headsup.sqlite3"
    monkeypatch.setenv("HEADSUP_DATABASE_URL", url)
    return url


@contextmanager
def serving(*options: str) -> Iterator[tuple[subprocess.Popen[str], httpx.Client]]:
    command = [sys.executable, "-c", PROGRAM, "--port", "0", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout is not None
            announced = process.stdout.readline().split()
            assert announced[:2] == ["listening", "on"]
            with httpx.Client(base_url=announced[2], trust_env=False) as client:
                yield process, client
        finally:
            process.kill()


def commands(*arguments: str) -> Result:
    app = Typer()
    app.add_typer(keys_app, name="keys")
    app.add_typer(db_app, name="db")
    app.command("serve")(serve)
    return CliRunner().invoke(app, arguments)


def batch(number: int) -> str:
    report = message(detection(15 * (number % 7), 8 * number), at=datetime.now(UTC) - HOUR, number=number)
    return ObservationBatch(sent_at=datetime.now(UTC), reports=(report,)).model_dump_json()


def test_an_answered_write_survives_a_kill(url: str) -> None:
    answered = []
    with serving() as (process, client):
        for number in range(10):
            answer = client.post(
                "/v1/observations", content=batch(number), headers={"Content-Type": "application/json"}
            )
            answered += ObservationBatchResult.model_validate_json(answer.content).results[0].detections
        process.send_signal(signal.SIGKILL)
        process.wait()
    with serving() as (_, client):
        found = [client.get(f"/v1/obstacles/{item.obstacle_id}").status_code for item in answered]
    assert found == [200] * 10


def test_an_interrupted_server_ends_by_itself(url: str) -> None:
    with serving() as (process, client):
        assert client.get("/healthz").status_code == 200
        process.send_signal(signal.SIGTERM)
        process.wait(15)
        assert process.returncode in (0, -signal.SIGTERM, 128 + signal.SIGTERM)


def test_a_database_in_use_is_durable_and_checked(url: str, tmp_path: Path) -> None:
    with serving():
        engine = create_engine(f"sqlite:///{tmp_path}/headsup.sqlite3")
        with engine.connect() as connection:
            assert connection.execute(text("PRAGMA journal_mode")).scalar_one() == "wal"
            tables = connection.execute(text("SELECT count(*) FROM sqlite_master WHERE name = 'obstacle'"))
            assert tables.scalar_one() == 1
        engine.dispose()


def test_without_a_key_the_server_does_not_listen_beyond_loopback(url: str) -> None:
    result = commands("serve", "--host", "0.0.0.0", "--port", "0")  # noqa: S104
    assert result.exit_code == 1
    assert result.stderr.strip().splitlines()[-1].startswith("refusing to listen on 0.0.0.0")


def test_a_schema_of_another_version_is_refused_naming_the_command(url: str, tmp_path: Path) -> None:
    assert commands("db", "upgrade").exit_code == 0
    engine = create_engine(f"sqlite:///{tmp_path}/headsup.sqlite3")
    with engine.begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '2026_11_22_first_tables'"))
    engine.dispose()
    result = commands("serve", "--port", "0")
    assert result.exit_code == 1
    assert "run `headsup db upgrade`" in result.stderr


def test_a_key_is_printed_once_and_alone_and_only_its_hash_is_kept(url: str, tmp_path: Path) -> None:
    created = commands("keys", "create", "--role", "vehicle", "--name", "ego1")
    key = created.stdout.strip()
    assert (created.exit_code, len(key.split())) == (0, 1)
    assert key.encode() not in (tmp_path / "headsup.sqlite3").read_bytes()
    listed = commands("keys", "list").stdout
    assert "ego1" in listed
    assert "valid" in listed
    identifier = listed.split()[0]
    assert re.search(rf"^{identifier}  vehicle   {MINUTE}  valid  ego1$", listed, re.MULTILINE)
    assert commands("keys", "revoke", identifier).exit_code == 0
    assert re.search(rf"  {MINUTE}  revoked {MINUTE}  ego1$", commands("keys", "list").stdout, re.MULTILINE)
    again, unknown = commands("keys", "revoke", identifier), commands("keys", "revoke", str(uuid4()))
    assert (again.exit_code, unknown.exit_code) == (1, 1)
    assert re.fullmatch(rf"the key {identifier} is revoked already, since {MINUTE}\n", again.stderr)
    assert unknown.stderr.startswith("there is no key")


@pytest.mark.parametrize("name", ["", "  ", "ego\n1", "ego\x1b[2J", "ego\u202e1", "e" * 65])
def test_a_name_that_would_deceive_whoever_reads_the_list_is_refused(url: str, name: str) -> None:
    assert commands("keys", "create", "--role", "vehicle", "--name", name).exit_code == 2
    assert commands("keys", "list").stdout == ""


def test_a_reader_that_has_had_enough_ends_the_list_quietly(url: str) -> None:
    for name in ("ego1", "ego2"):
        commands("keys", "create", "--role", "vehicle", "--name", name)
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", "headsup.cli", "keys", "list"], stdout=writing, stderr=subprocess.PIPE, text=True
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (1, "")


def test_a_key_opens_a_guarded_server(url: str) -> None:
    key = commands("keys", "create", "--role", "vehicle", "--name", "ego1").stdout.strip()
    with serving() as (_, client):
        where = {"lat": 0, "lon": 0}
        answers = [client.get("/v1/obstacles", params=where, headers=headers) for headers in ({}, bearer(key))]
    assert [answer.status_code for answer in answers] == [401, 200]


def bearer(key: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {key}"}


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        ("HEADSUP_DATABASE_URL", "sqlite+aiosqlite:////nowhere/at/all.sqlite3"),
        ("HEADSUP_DATABASE_URL", "mysql://x/y"),
        ("HEADSUP_BOOTSTRAP_OPERATOR_KEY", "short"),
        ("HEADSUP_PORT", "many"),
    ],
)
def test_what_cannot_work_ends_with_one_line(
    url: str, monkeypatch: pytest.MonkeyPatch, variable: str, value: str
) -> None:
    monkeypatch.setitem(os.environ, variable, value)
    result = commands("serve")
    assert result.exit_code == 1
    assert len(result.stderr.strip().splitlines()) == 1


def test_the_policy_that_is_shown_is_the_one_in_force(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "policy.toml"
    path.write_text("[life]\nconfirming_witnesses = 3\n")
    monkeypatch.setenv("HEADSUP_POLICY_FILE", str(path))
    shown = CliRunner().invoke(policy_app, ["show"])
    assert shown.exit_code == 0
    assert "# One vehicle may be wrong, or lie.\nconfirming_witnesses = 3\n" in shown.stdout
    path.write_text("[life]\nconfirming_witness = 3\n")
    for refusal in (CliRunner().invoke(policy_app, ["show"]), commands("serve", "--port", "0")):
        assert refusal.exit_code == 1
        assert refusal.stderr.startswith(f"{path}: life.confirming_witness is unknown")


def test_faults_of_settings_and_policy_are_listed_together(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "policy.toml"
    path.write_text("[life]\nconfirming_witnesses = 0\n")
    for name, value in {"HEADSUP_POLICY_FILE": str(path), "HEADSUP_PORT": "many", "HEADSUP_DRAIN_S": "-1"}.items():
        monkeypatch.setenv(name, value)
    told = sorted(commands("serve").stderr.splitlines())
    assert [line.split(": ")[0] for line in told] == [str(path), "HEADSUP_DRAIN_S", "HEADSUP_PORT"]
    # Other commands do not need the policy, and this one nothing else.
    monkeypatch.delenv("HEADSUP_PORT")
    monkeypatch.delenv("HEADSUP_DRAIN_S")
    assert commands("db", "upgrade").exit_code == 0
    monkeypatch.setenv("HEADSUP_PORT", "many")
    monkeypatch.delenv("HEADSUP_POLICY_FILE")
    assert CliRunner().invoke(policy_app, ["show"]).exit_code == 0


def test_what_looks_like_a_setting_and_is_none_is_told_with_the_nearest_one(tmp_path: Path) -> None:
    with served(tmp_path / "headsup.sqlite3", HEADSUP_LOG_FROMAT="json", HEADSUP_XYZZY="1", HEADSUP_DATA="x") as server:
        pass
    told = [line.partition(": ")[2] for line in server.log().splitlines() if "server.running" in line]
    assert told[:-2] == [
        "HEADSUP_LOG_FROMAT is no setting: did you mean HEADSUP_LOG_FORMAT?",
        "HEADSUP_XYZZY is no setting",
    ]
    assert server.log().count("running open") == 1
