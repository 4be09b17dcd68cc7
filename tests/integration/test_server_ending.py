"""How the server ends: it says so first, answers what it has taken, and tells its sockets."""

from __future__ import annotations

import asyncio
import sqlite3
from contextlib import closing
from pathlib import Path

import httpx
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from contract.events import SUBPROTOCOL, Position
from contract.observation import ObservationBatchResult
from tests.integration.asking import JSON, ago
from tests.integration.serving import Served, served
from tests.integration.test_server_trust import batch
from tests.unit.server.making import PATRAS, detection, message


async def test_reports_that_wait_for_the_database_are_answered_before_the_server_ends(tmp_path: Path) -> None:
    database = tmp_path / "headsup.sqlite3"
    with served(database) as server, closing(sqlite3.connect(database, isolation_level=None)) as writer:
        writer.execute("BEGIN IMMEDIATE")
        async with server.async_client() as client:
            waiting = [asyncio.create_task(reported(client, number)) for number in range(3)]
            await asyncio.sleep(0.5)
            assert not any(task.done() for task in waiting)
            server.told_to_end()
            await asyncio.sleep(0.5)
            assert server.process.poll() is None
            writer.execute("ROLLBACK")
            answers = await asyncio.gather(*waiting)
        await asyncio.to_thread(server.process.wait, 20)
    assert [answer.status_code for answer in answers] == [200] * 3
    results = [ObservationBatchResult.model_validate_json(answer.content).results[0] for answer in answers]
    told = {str(result.detections[0].obstacle_id).replace("-", "") for result in results}
    with closing(sqlite3.connect(database)) as connection:
        assert {identifier for (identifier,) in connection.execute("SELECT id FROM obstacle")} == told


async def reported(client: httpx.AsyncClient, number: int) -> httpx.Response:
    report = message(detection(15 * number, 0), at=ago(1), number=number)
    return await client.post("/v1/observations", content=batch(report), headers=JSON)


def test_sockets_are_told_that_the_service_restarts(tmp_path: Path) -> None:
    with (
        served(tmp_path / "headsup.sqlite3") as server,
        connect(server.websocket, subprotocols=[SUBPROTOCOL], proxy=None) as socket,
    ):
        socket.send(Position(position_seq=1, position=PATRAS, radius_m=500).model_dump_json())
        socket.recv(10)
        server.told_to_end()
        with pytest.raises(ConnectionClosed) as closed:
            socket.recv(20)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code in (1001, 1012)
        server.process.wait(20)


def test_a_server_that_is_to_end_says_so_to_balancers_before_it_closes_its_door(tmp_path: Path) -> None:
    with served(tmp_path / "headsup.sqlite3", HEADSUP_DRAIN_S="3") as server, server.client() as client:
        assert client.get("/readyz").status_code == 200
        server.told_to_end()
        told = until_not_ready(client)
        assert told.json()["type"] == "urn:headsup:problem:shutting-down"
        assert "Retry-After" in told.headers
        assert client.get("/v1/obstacles?lat=0&lon=0").status_code == 200
        assert client.get("/healthz").status_code == 200
        server.process.wait(20)
        assert server.process.returncode == 0
    assert ended_well(server)


def until_not_ready(client: httpx.Client) -> httpx.Response:
    for _ in range(100):
        answer = client.get("/readyz")
        if answer.status_code != 200:
            return answer
    raise AssertionError("it stayed ready")


def ended_well(server: Served) -> bool:
    lines = server.log().splitlines()
    return lines[-1].endswith("server.running: ended") and "Traceback" not in server.log()
