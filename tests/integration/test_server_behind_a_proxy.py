"""A real process behind a trusted proxy: whose address counts, what sockets are refused, what a socket may send."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from contract.events import SUBPROTOCOL, Moved, Position, Snapshot, server_message
from tests.integration.conftest import OPERATOR_KEY
from tests.integration.keys_of import bearer
from tests.integration.serving import Served, served
from tests.integration.test_server_process import commands
from tests.unit.server.making import PATRAS


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with served(
        tmp_path_factory.mktemp("proxied") / "headsup.sqlite3",
        HEADSUP_BOOTSTRAP_OPERATOR_KEY=OPERATOR_KEY,
        HEADSUP_TRUSTED_PROXIES="127.0.0.1",
        HEADSUP_FAILED_KEYS_PER_MINUTE="2",
        HEADSUP_SOCKETS_PER_KEY="2",
        HEADSUP_VEHICLE_RATE_HZ="0.001",
        HEADSUP_RATE_BURST_S="3000",
    ) as server:
        yield server


def opened(server: Served, key: str, **headers: str) -> ClientConnection:
    return connect(
        server.websocket, subprotocols=[SUBPROTOCOL], additional_headers={**bearer(key), **headers}, proxy=None
    )


def opened_soon(server: Served, key: str) -> ClientConnection:
    """A socket, as soon as the server has noticed that another one is closed."""
    for _ in range(100):
        try:
            return opened(server, key)
        except InvalidStatus:
            time.sleep(0.05)
    return opened(server, key)


def position(seq: int) -> str:
    return Position(position_seq=seq, position=PATRAS, radius_m=500).model_dump_json()


def vehicle_key(server: Served, monkeypatch: pytest.MonkeyPatch) -> str:
    database = server.log_path.with_suffix(".sqlite3")
    monkeypatch.setenv("HEADSUP_DATABASE_URL", f"sqlite+aiosqlite:///{database}")
    return commands("keys", "create", "--role", "vehicle", "--name", "ego1").stdout.strip()


def test_the_address_that_the_proxy_names_is_the_one_that_counts(server: Served) -> None:
    with server.client() as client:
        statuses = [
            client.get("/v1/actions", headers={"X-Forwarded-For": address}).status_code
            for address in ("203.0.113.5",) * 3 + ("198.51.100.7",)
        ]
        # What the caller itself put in front of the proxy's entry is not believed.
        pretended = client.get("/v1/actions", headers={"X-Forwarded-For": "192.0.2.1, 203.0.113.5"})
    assert [*statuses, pretended.status_code] == [401, 401, 429, 401, 429]


def test_links_have_the_scheme_that_the_proxy_was_asked_by(server: Served) -> None:
    with server.client() as client:
        headers = bearer(OPERATOR_KEY) | {"X-Forwarded-Proto": "https", "Host": "obstacles.example"}
        links = client.get("/ogc", headers=headers).json()["links"]
    assert links
    assert all(link["href"].startswith("https://obstacles.example/") for link in links)


def test_no_answer_names_the_program(server: Served) -> None:
    with server.client() as client:
        assert "server" not in client.get("/healthz").headers


def test_a_key_has_so_many_sockets_and_one_more_when_it_closes_one(server: Served) -> None:
    with opened(server, OPERATOR_KEY) as first, opened(server, OPERATOR_KEY):
        with pytest.raises(InvalidStatus) as refused:
            opened(server, OPERATOR_KEY)
        assert refused.value.response.status_code == 429
        assert int(refused.value.response.headers["Retry-After"]) > 0
        assert "X-Request-Id" in refused.value.response.headers
        first.close()
        with opened_soon(server, OPERATOR_KEY) as again:
            again.send(position(1))
            assert isinstance(server_message.validate_json(again.recv(10)), Snapshot)


def test_a_page_of_another_origin_opens_no_socket(server: Served) -> None:
    with pytest.raises(InvalidStatus) as refused:
        opened(server, OPERATOR_KEY, Origin="https://evil.example")
    assert refused.value.response.status_code == 403
    own = server.address
    with opened(server, OPERATOR_KEY, Origin=own) as socket:
        assert socket.subprotocol == SUBPROTOCOL


def test_positions_beyond_the_rate_wait_and_the_socket_stays(server: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    # Three requests in 3,000 s: the opening, and two positions.
    with opened(server, vehicle_key(server, monkeypatch)) as socket:
        socket.send(position(1))
        assert isinstance(server_message.validate_json(socket.recv(10)), Snapshot)
        socket.send(position(2))
        assert server_message.validate_json(socket.recv(10)) == Moved(position_seq=2)
        socket.send(position(3))
        with pytest.raises(TimeoutError):
            socket.recv(1)
        socket.ping().wait(10)
