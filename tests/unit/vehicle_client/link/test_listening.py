"""Hearing the server: by WebSocket, by polling where none passes, rarely where the car is refused."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from http import HTTPStatus
from random import Random

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import ServerConnection, serve
from websockets.typing import Subprotocol

from contract.events import SUBPROTOCOL, Moved, Position, Snapshot
from contract.obstacle import ObstacleCollection
from tests.unit.vehicle_client.making import PATRAS, feature
from vehicle_client.area import Area, Surveyed
from vehicle_client.link.listening import POLL_AFTER, POLL_EVERY_S, PUSH_AGAIN_S, Listener
from vehicle_client.link.push import AREA_RADIUS_M


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


class Server:
    """A server of one obstacle; `socket_status` and `page_status` refuse one way or the other."""

    def __init__(self) -> None:
        self.socket_status = self.page_status = HTTPStatus.OK
        self.asked: list[str] = []
        self.cuts = False

    def decide(self, connection: ServerConnection, request: Request) -> Response | None:
        is_socket = "upgrade" in request.headers
        self.asked.append("socket" if is_socket else "page")
        if is_socket:
            return None if self.socket_status is HTTPStatus.OK else connection.respond(self.socket_status, "no\n")
        if self.page_status is not HTTPStatus.OK:
            return connection.respond(self.page_status, "no\n")
        return connection.respond(HTTPStatus.OK, ObstacleCollection(features=(feature(2),)).model_dump_json())

    def talk(self, connection: ServerConnection) -> None:
        with suppress(ConnectionClosed):
            while True:
                seq = Position.model_validate_json(connection.recv()).position_seq
                if self.cuts:
                    return
                first = Snapshot(position_seq=seq, obstacles=(feature(1),))
                connection.send((first if seq == 1 else Moved(position_seq=seq)).model_dump_json())

    def count(self, way: str) -> int:
        return self.asked.count(way)


@contextmanager
def listening_to(server: Server, clock: Clock) -> Iterator[Listener]:
    with serve(
        server.talk, "127.0.0.1", 0, subprotocols=[Subprotocol(SUBPROTOCOL)], process_request=server.decide
    ) as running:
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        try:
            with closing(listener(running.socket.getsockname()[1], clock)) as heard:
                yield heard
        finally:
            running.shutdown()
            thread.join()


def listener(port: int, clock: Clock, timeout_s: float = 5.0) -> Listener:
    jitter = Random(1)  # noqa: S311  # not a secret
    return Listener(f"http://127.0.0.1:{port}", "key", timeout_s=timeout_s, jitter=jitter, clock=clock)


def obstacles(heard: list[object]) -> list[int]:
    return [o.id.int for message in heard if isinstance(message, Surveyed) for o in message.obstacles]


def test_a_socket_is_used_as_long_as_it_stands() -> None:
    server, clock = Server(), Clock()
    with listening_to(server, clock) as heard:
        assert obstacles(heard.hear(PATRAS)) == [1]
        for _ in range(3):
            assert len(heard.hear(PATRAS)) == 1
        assert heard.is_pushed
    assert server.asked == ["socket"]


def test_a_socket_that_is_cut_is_opened_again_and_begins_with_all_there_is() -> None:
    server, clock = Server(), Clock()
    with listening_to(server, clock) as heard:
        heard.hear(PATRAS)
        server.cuts = True
        assert heard.hear(PATRAS) == []
        assert not heard.is_pushed
        server.cuts = False
        clock.now_s += 1
        assert heard.hear(PATRAS) == [Surveyed(Area(PATRAS, AREA_RADIUS_M), (feature(1),))]


@pytest.mark.parametrize("status", [400, 404, 426, 501, 502])
def test_where_no_socket_passes_the_server_is_polled_and_the_socket_tried_now_and_then(status: int) -> None:
    server, clock = Server(), Clock()
    server.socket_status = HTTPStatus(status)
    with listening_to(server, clock) as heard:
        while not heard.is_polling:
            heard.hear(PATRAS)
            clock.now_s += 1
        assert server.count("socket") == POLL_AFTER
        clock.now_s += POLL_EVERY_S
        assert obstacles(heard.hear(PATRAS, heading_rad=0.0)) == [2]
        assert heard.hear(PATRAS) == []
        server.socket_status = HTTPStatus.OK
        clock.now_s += PUSH_AGAIN_S * 1.1
        assert obstacles(heard.hear(PATRAS)) == [1]
        assert (heard.is_pushed, heard.is_polling) == (True, False)


def test_polling_goes_on_at_its_pace_and_asks_for_a_socket_rarely() -> None:
    server, clock = Server(), Clock()
    server.socket_status = HTTPStatus.BAD_GATEWAY
    with listening_to(server, clock) as heard:
        for _ in range(600):
            heard.hear(PATRAS)
            clock.now_s += 1
    assert 150 < server.count("page") <= 200
    assert server.count("socket") <= POLL_AFTER + 3


@pytest.mark.parametrize("status", [HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN])
def test_a_refused_key_is_told_once_and_asked_about_rarely(
    status: HTTPStatus, caplog: pytest.LogCaptureFixture
) -> None:
    server, clock = Server(), Clock()
    server.socket_status = server.page_status = status
    with listening_to(server, clock) as heard:
        for _ in range(600):
            assert heard.hear(PATRAS) == []
            clock.now_s += 1
        assert str(int(status)) in str(heard.refusal)
        assert "set HEADSUP_API_KEY to a key" in str(heard.refusal)
        assert len(server.asked) < 12
        assert len([r for r in caplog.records if r.levelname == "ERROR" and "vehicle_client" in r.name]) == 1
        server.socket_status = HTTPStatus.OK
        clock.now_s += PUSH_AGAIN_S * 1.1
        assert obstacles(heard.hear(PATRAS)) == [1]
        assert heard.refusal is None


def test_a_server_that_is_away_is_asked_ever_more_rarely() -> None:
    server, clock = Server(), Clock()
    server.socket_status = server.page_status = HTTPStatus.SERVICE_UNAVAILABLE
    with listening_to(server, clock) as heard:
        for _ in range(600):
            assert heard.hear(PATRAS) == []
            clock.now_s += 1
        assert heard.refusal is None
    assert 5 < server.count("socket") < 25
    assert server.count("page") < 25


def test_what_accepts_and_never_answers_is_given_up() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as deaf,
        closing(listener(deaf.getsockname()[1], Clock(), timeout_s=0.2)) as heard,
    ):
        assert heard.hear(PATRAS) == []
        assert not heard.is_pushed
