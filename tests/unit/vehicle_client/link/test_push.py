"""The push channel against servers that misbehave: a clear error, never a crash, never for ever."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve
from websockets.typing import Subprotocol

from contract.events import SUBPROTOCOL, Moved, Position, Snapshot, Updated
from contract.geometry import LatLon
from tests.unit.vehicle_client.making import PATRAS, feature
from vehicle_client.area import Area, Reached, Surveyed
from vehicle_client.link.push import AREA_RADIUS_M, MAX_MESSAGE_BYTES, PushChannel, PushError

Behaviour = Callable[[ServerConnection], None]


@contextmanager
def channel_to(behaviour: Behaviour, timeout_s: float = 5.0) -> Iterator[PushChannel]:
    """A channel to a server that does this with each connection."""

    def handle(connection: ServerConnection) -> None:
        try:
            behaviour(connection)
        except ConnectionClosed:
            return

    with serve(handle, "127.0.0.1", 0, subprotocols=[Subprotocol(SUBPROTOCOL)]) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            url = f"http://127.0.0.1:{server.socket.getsockname()[1]}"
            with closing(PushChannel(url, None, timeout_s=timeout_s)) as channel:
                yield channel
        finally:
            server.shutdown()
            thread.join()


def position_from(connection: ServerConnection) -> Position:
    return Position.model_validate_json(connection.recv())


def acknowledge_all(connection: ServerConnection) -> None:
    while True:
        seq = position_from(connection).position_seq
        old = [Moved(position_seq=seq - 1)] if seq > 1 else []
        for said in (*old, Snapshot(position_seq=seq, obstacles=()) if seq == 1 else Moved(position_seq=seq)):
            connection.send(said.model_dump_json())


def test_an_exchange_hears_everything_up_to_its_own_acknowledgement_with_the_area_that_is_meant() -> None:
    places = [LatLon(latitude_deg=38.2 + n / 100, longitude_deg=21.7) for n in range(3)]
    first, second, third = (Area(place, AREA_RADIUS_M) for place in places)
    with channel_to(acknowledge_all) as channel:
        heard = [channel.exchange(place) for place in places]
    assert heard == [[Surveyed(first, ())], [Reached(first), Reached(second)], [Reached(second), Reached(third)]]


def test_a_server_that_speaks_of_a_place_where_the_car_never_was_is_an_error() -> None:
    def strange(connection: ServerConnection) -> None:
        connection.recv()
        connection.send(Snapshot(position_seq=77, obstacles=()).model_dump_json())

    with channel_to(strange) as channel, pytest.raises(PushError, match="position 77"):
        channel.exchange(PATRAS)


def test_the_car_says_where_it_is_and_how_far_it_listens() -> None:
    positions = []

    def remember(connection: ServerConnection) -> None:
        positions.append(position_from(connection))
        connection.send(Moved(position_seq=1).model_dump_json())

    with channel_to(remember) as channel:
        channel.exchange(PATRAS)
    assert positions == [Position(position_seq=1, position=PATRAS, radius_m=AREA_RADIUS_M)]


@pytest.mark.parametrize(
    "said", ["", "{", "[]", '{"type": "weather"}', '{"type": "moved", "position_seq": "x"}', b"\xff"]
)
def test_a_message_of_another_contract_is_an_error(said: str | bytes) -> None:
    def talk(connection: ServerConnection) -> None:
        connection.recv()
        connection.send(said)

    with channel_to(talk) as channel, pytest.raises(PushError, match="contract"):
        channel.exchange(PATRAS)


def test_a_server_that_hangs_up_is_an_error_now_and_later() -> None:
    with channel_to(lambda connection: connection.close()) as channel:
        for _ in range(2):
            with pytest.raises(PushError, match="broke"):
                channel.exchange(PATRAS)


def test_a_server_that_never_acknowledges_is_given_up() -> None:
    def chatter(connection: ServerConnection) -> None:
        while True:
            connection.send(Updated(position_seq=1, obstacle=feature()).model_dump_json())

    with channel_to(chatter, timeout_s=2.0) as channel, pytest.raises(PushError, match="not acknowledged"):
        channel.exchange(PATRAS)


def test_a_message_without_end_is_an_error() -> None:
    def flood(connection: ServerConnection) -> None:
        connection.recv()
        connection.send("x" * (MAX_MESSAGE_BYTES + 1))

    with channel_to(flood) as channel, pytest.raises(PushError, match="broke"):
        channel.exchange(PATRAS)


def test_what_does_not_speak_the_subprotocol_is_no_channel() -> None:
    with serve(lambda _: None, "127.0.0.1", 0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            with pytest.raises(PushError, match="speak"):
                PushChannel(f"http://127.0.0.1:{server.socket.getsockname()[1]}", None)
        finally:
            server.shutdown()
            thread.join()
