"""Keys, positions and passwords never reach the log or an answer, whatever goes wrong."""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path

import httpx
import pytest
from pydantic import ValidationError
from websockets.sync.client import connect

from contract.events import SUBPROTOCOL, Position
from server.settings import Settings
from tests.integration.asking import JSON, ago
from tests.integration.conftest import OPERATOR_KEY
from tests.integration.keys_of import bearer
from tests.integration.serving import Served, refused, served
from tests.integration.test_server_trust import batch
from tests.unit.server.making import PATRAS, detection, message

WRONG_KEY = "hu_a-key-that-nobody-knows-0123456789"
PLACES = ("38.24", "21.73", "48.137", "11.575")
#: What the log takes from clocks: 08:50:38.247 is no latitude.
OF_CLOCKS = ("time", "duration_ms")


def a_session_with_everything(server: Served, database: Path) -> list[httpx.Response]:
    """Requests that succeed and fail in every way, at last with a table gone."""
    at_patras = {"lat": PATRAS.latitude_deg, "lon": PATRAS.longitude_deg}
    key, report = bearer(OPERATOR_KEY), message(detection(), at=ago(1))
    with server.client() as client:
        answers = [
            client.get("/v1/obstacles", params=at_patras, headers=key),
            client.get("/v1/obstacles", params=at_patras | {"radius_m": -1}, headers=key),
            client.get("/v1/obstacles", params=at_patras, headers=bearer(WRONG_KEY)),
            client.get("/v1/obstacles", params=at_patras | {"api_key": WRONG_KEY}, headers=key),
            client.get(f"/48.137/11.575/{WRONG_KEY}", headers=key),
            client.post("/v1/observations", content=batch(report), headers=JSON | key),
            client.post("/v1/observations", content='{"lat": 48.137, "lon": 11.575', headers=JSON | key),
            client.post("/v1/observations", content=batch(report).replace("38.2466", "948.137"), headers=JSON | key),
        ]
        converse(server, key)
        with sqlite3.connect(database) as connection:
            connection.execute("ALTER TABLE obstacle RENAME TO gone")
        answers += [
            client.post("/v1/observations", content=batch(report), headers=JSON | key),
            client.post(
                "/v1/observations", content=batch(message(detection(), at=ago(0.5), number=1)), headers=JSON | key
            ),
            client.get("/v1/obstacles", params=at_patras | {"radius_m": 5_000}, headers=key),
            client.get("/readyz"),
        ]
    return answers


def converse(server: Served, key: dict[str, str]) -> None:
    position = Position(position_seq=1, position=PATRAS, radius_m=500).model_dump_json()
    with connect(server.websocket, subprotocols=[SUBPROTOCOL], additional_headers=key, proxy=None) as socket:
        socket.send(position)
        socket.recv(10)
        socket.send('{"latitude_deg": 48.137}')
        with pytest.raises(Exception, match="4400"):
            socket.recv(10)


def test_a_log_of_everything_has_neither_keys_nor_positions(tmp_path: Path) -> None:
    database = tmp_path / "headsup.sqlite3"
    with served(
        database,
        HEADSUP_BOOTSTRAP_OPERATOR_KEY=OPERATOR_KEY,
        HEADSUP_LOG_LEVEL="debug",
        HEADSUP_LOG_FORMAT="json",
        HEADSUP_LOG_REQUESTS="all",
    ) as server:
        answers = a_session_with_everything(server, database)
    statuses = [answer.status_code for answer in answers]
    assert statuses[:8] == [200, 422, 401, 422, 404, 200, 422, 422]
    assert 500 in statuses[8:]
    entries = [json.loads(line) for line in server.log().splitlines()]
    text = json.dumps([{name: of for name, of in entry.items() if name not in OF_CLOCKS} for entry in entries])
    for secret in (OPERATOR_KEY, WRONG_KEY, "Bearer", "ego1", *PLACES):
        assert secret not in text
    for answer in answers[1:]:
        assert not [secret for secret in (OPERATOR_KEY, WRONG_KEY, "sqlite", "gone") if secret in answer.text]
    requests = [entry for entry in entries if entry["message"] == "request"]
    assert [entry["status"] for entry in requests] == statuses
    assert {entry["route"] for entry in requests} == {"/v1/obstacles", "/v1/observations", "none", "/readyz"}
    assert {entry.get("key_id") for entry in requests} == {"bootstrap", None}
    (failure, *_) = [entry["failure"] for entry in entries if entry["message"] == "unexpected error"]
    assert "OperationalError" in failure[0]["type"]


def test_a_refusal_to_start_does_not_show_the_database_password() -> None:
    told = refused(HEADSUP_DATABASE_URL="postgresql+asyncpg://headsup:sesame-open@127.0.0.1:1/headsup")
    assert "sesame" not in told
    assert len(told.strip().splitlines()) == 1


@pytest.mark.parametrize("url", ["postgresql+asyncpg://a:sesame@h:port/b", "postgresql://a:sesame@h/b", "sesame"])
def test_a_faulty_database_url_is_not_repeated(url: str) -> None:
    with pytest.raises(ValidationError) as refusal:
        Settings(database_url=url)
    assert "sesame" not in refusal.value.errors()[0]["msg"]
