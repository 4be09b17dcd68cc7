"""Push over a real connection: uvicorn on loopback, the `websockets` client."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import AsyncIterator
from dataclasses import dataclass
from datetime import UTC, datetime

import httpx
import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from contract.events import (
    SUBPROTOCOL,
    Appeared,
    Left,
    Moved,
    Position,
    Removed,
    ServerMessage,
    Snapshot,
    Updated,
    server_message,
)
from contract.geometry import LatLon
from contract.observation import ObservationBatch, ObservationReport
from server.geometry.geodesy import offset_from
from server.logs import FIELDS
from server.settings import Settings
from server.trust.keys import Keys, Role
from tests.integration.conftest import OPERATOR_KEY
from tests.integration.raw import served_here
from tests.unit.server.making import HOUR, PATRAS, absent, detection, message


@dataclass(frozen=True)
class Running:
    """A server that listens."""

    port: int
    keys: Keys

    def connect(self, key: str | None = None, subprotocol: str | None = SUBPROTOCOL) -> connect:
        return connect(
            f"ws://127.0.0.1:{self.port}/v1/events",
            subprotocols=[subprotocol] if subprotocol else None,
            additional_headers={"Authorization": f"Bearer {key}"} if key else None,
            proxy=None,
        )

    async def post(self, report: ObservationReport) -> None:
        batch = ObservationBatch(sent_at=datetime.now(UTC), reports=(report,))
        async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{self.port}", trust_env=False) as client:
            answer = await client.post("/v1/observations", content=batch.model_dump_json(), headers=HEADERS)
        answer.raise_for_status()


HEADERS = {"Content-Type": "application/json", "Authorization": f"Bearer {OPERATOR_KEY}"}


@pytest.fixture
async def running(guarded: Settings) -> AsyncIterator[Running]:
    async with served_here(guarded) as (app, port):
        yield Running(port, app.state.parts.keys)


async def received(socket: ClientConnection) -> ServerMessage:
    return server_message.validate_json(await asyncio.wait_for(socket.recv(), 10))


def at(seq: int, east_m: float = 0.0, radius_m: float = 100.0) -> str:
    position = offset_from(PATRAS, east_m, 0.0)
    return Position(position_seq=seq, position=position, radius_m=radius_m).model_dump_json()


def seen(east_m: float = 0.0, vehicle: str = "ego1", hours_ago: float = 5, length_mm: int = 1000) -> ObservationReport:
    place = offset_from(PATRAS, east_m, 0.0)
    when = datetime.now(UTC) - hours_ago * HOUR
    return message(detection(0, 0, length_mm), vehicle=vehicle, at=when, position=place)


async def test_the_first_position_is_answered_by_a_snapshot_of_the_area(running: Running) -> None:
    await running.post(seen(50))
    await running.post(seen(150))
    async with running.connect(OPERATOR_KEY) as socket:
        await socket.send(at(7))
        snapshot = await received(socket)
    assert socket.subprotocol == SUBPROTOCOL
    assert isinstance(snapshot, Snapshot)
    assert (snapshot.position_seq, len(snapshot.obstacles)) == (7, 1)


async def test_what_happens_in_the_area_is_pushed_after_the_commit(running: Running) -> None:
    async with running.connect(OPERATOR_KEY) as socket:
        await socket.send(at(1))
        assert isinstance(await received(socket), Snapshot)
        await running.post(seen(30))
        appeared = await received(socket)
        # The second report is the same key's: a pass of its own, since hours lie between.
        await running.post(seen(30, hours_ago=3, length_mm=1250))
        updated = await received(socket)
        assert isinstance(appeared, Appeared)
        assert isinstance(updated, Updated)
        assert (updated.obstacle.properties.version, updated.obstacle.properties.revision) == (2, 2)
        look = message(inspections=(absent(appeared.obstacle.id),), at=datetime.now(UTC) - HOUR)
        await running.post(look)
        removed = await received(socket)
        assert isinstance(removed, Removed)
        assert (removed.obstacle_id, removed.reason, removed.revision) == (appeared.obstacle.id, "absent", 3)


async def test_what_happens_elsewhere_is_not_pushed(running: Running) -> None:
    async with running.connect(OPERATOR_KEY) as socket:
        await socket.send(at(1))
        await received(socket)
        await running.post(seen(400, hours_ago=6))
        await running.post(seen(20))
        appeared = await received(socket)
    assert isinstance(appeared, Appeared)
    assert abs(appeared.obstacle.position.longitude_deg - PATRAS.longitude_deg) < 0.001


async def test_the_area_moves_and_obstacles_leave_later_than_they_enter(running: Running) -> None:
    await running.post(seen(150))
    async with running.connect(OPERATOR_KEY) as socket:
        heard: list[ServerMessage] = []
        for seq, east_m in enumerate([0, 60, 35, 20], start=1):
            await socket.send(at(seq, east_m))
            while not (heard and isinstance(heard[-1], Snapshot | Moved) and heard[-1].position_seq == seq):
                heard.append(await received(socket))
    kinds = [(type(item), item.position_seq) for item in heard]
    # 150 m away, 90 (in), 115 (outside R, inside 1.2 R: stays), 130 (left).
    assert kinds == [(Snapshot, 1), (Appeared, 2), (Moved, 2), (Moved, 3), (Left, 4), (Moved, 4)]


@pytest.mark.parametrize("frame", ["no JSON", "{}", '{"type": "position", "position_seq": 0}', b"\x00\x01"])
async def test_a_bad_message_closes_with_4400(running: Running, frame: str | bytes) -> None:
    async with running.connect(OPERATOR_KEY) as socket:
        await socket.send(frame)
        with pytest.raises(ConnectionClosed) as closed:
            await received(socket)
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 4400


async def test_without_a_key_the_connection_is_refused_before_it_is_accepted(
    running: Running, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    for key in (None, "wrong"):
        with pytest.raises(InvalidStatus) as refused:
            async with running.connect(key):
                pass
        assert refused.value.response.status_code == 401
        assert json.loads(refused.value.response.body)["type"] == "urn:headsup:problem:unauthenticated"
    told = [getattr(record, FIELDS) for record in caplog.records if record.name == "server.web.journal"]
    assert [(item["method"], item["route"], item["status"]) for item in told] == [("GET", "/v1/events", 401)] * 2
    # What is somebody else's mistake is no error of ours.
    assert max(record.levelno for record in caplog.records) <= logging.INFO


@pytest.fixture
def slow(guarded: Settings) -> Settings:
    """Two requests a second, and two at once: the opening of a socket, and its first position."""
    return guarded.model_copy(update={"operator_rate_hz": 2.0, "rate_burst_s": 1.0})


async def test_beyond_the_rate_the_newest_position_overtakes_those_that_wait(slow: Settings) -> None:
    async with served_here(slow) as (app, port), Running(port, app.state.parts.keys).connect(OPERATOR_KEY) as socket:
        await socket.send(at(1))
        assert isinstance(await received(socket), Snapshot)
        # More than are read while one waits: the connection stands still, and goes on where it stood.
        for seq in range(2, 500):
            await socket.send(at(seq))
        acknowledged = 0
        while acknowledged < 499:
            moved = await received(socket)
            assert isinstance(moved, Moved)
            assert moved.position_seq == 499 or moved.position_seq >= acknowledged + 200
            acknowledged = moved.position_seq


async def test_another_subprotocol_closes_with_4426(running: Running) -> None:
    async with running.connect(OPERATOR_KEY, subprotocol="headsup.v0") as socket:
        with pytest.raises(ConnectionClosed) as closed:
            await received(socket)
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 4426


async def test_a_revoked_key_closes_with_4401(running: Running, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("server.web.events_socket._KEY_CHECK_INTERVAL_S", 0.05)
    key = await running.keys.create(Role.VEHICLE, "ego1")
    async with running.connect(key) as socket:
        await socket.send(at(1))
        assert isinstance(await received(socket), Snapshot)
        (row,) = await running.keys.all()
        assert await running.keys.revoke(row["id"])
        with pytest.raises(ConnectionClosed) as closed:
            await received(socket)
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 4401


async def test_a_reader_may_listen_and_not_post(running: Running) -> None:
    key = await running.keys.create(Role.READER, "map")
    async with running.connect(key) as socket:
        await socket.send(at(1))
        assert isinstance(await received(socket), Snapshot)
    batch = ObservationBatch(sent_at=datetime.now(UTC), reports=(seen(),))
    headers = HEADERS | {"Authorization": f"Bearer {key}"}
    async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{running.port}", trust_env=False) as client:
        answer = await client.post("/v1/observations", content=batch.model_dump_json(), headers=headers)
    assert (answer.status_code, answer.json()["type"]) == (403, "urn:headsup:problem:forbidden")


async def test_one_vehicle_warns_another(running: Running) -> None:
    """The point of it all: two connections, one report, the other vehicle hears of it."""
    async with running.connect(OPERATOR_KEY) as behind, running.connect(OPERATOR_KEY) as far:
        for socket, east_m in ((behind, -50.0), (far, 5_000.0)):
            await socket.send(at(1, east_m, radius_m=300))
            assert isinstance(await received(socket), Snapshot)
        await running.post(seen(100))
        warned = await received(behind)
        assert isinstance(warned, Appeared)
        await far.send(at(2, 5_000.0, radius_m=300))
        assert isinstance(await received(far), Moved)
    assert isinstance(warned.obstacle.position, LatLon)
