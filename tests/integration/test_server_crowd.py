"""Hundreds of vehicles on the push channel, some of which never read: nobody waits for them, and memory is bounded."""

from __future__ import annotations

import asyncio
import json
import random
from contextlib import AsyncExitStack
from datetime import UTC, datetime
from pathlib import Path

import httpx
import pytest
from websockets.asyncio.client import ClientConnection, connect

from contract.events import SUBPROTOCOL, Position
from contract.observation import ObservationBatch
from tests.integration.asking import JSON
from tests.integration.processes import ServerProcess, serving_processes
from tests.unit.server.making import HOUR, PATRAS, detection, message

# What a socket costs with its buffers, and what a machine's allocator keeps: some 100 KiB and 50 MiB.
_SOCKET_BYTES, _SLACK_BYTES = 200 << 10, 64 << 20


class _Crowd:
    """Vehicles in one street: those that read count what they are told."""

    def __init__(self, server: ServerProcess) -> None:
        self._url = f"ws://127.0.0.1:{server.port}/v1/events"
        self.revisions: dict[int, dict[str, int]] = {}

    async def joined(self, stack: AsyncExitStack, reads: bool, number: int) -> None:
        # Little is buffered on this side, so that a vehicle that does not read is felt at the other.
        socket = await stack.enter_async_context(
            connect(self._url, subprotocols=[SUBPROTOCOL], proxy=None, max_queue=1, open_timeout=60, close_timeout=0.2)
        )
        await socket.send(Position(position_seq=1, position=PATRAS, radius_m=1_000).model_dump_json())
        if reads:
            json.loads(await asyncio.wait_for(socket.recv(), 60))
            self.revisions[number] = {}
            reader = asyncio.create_task(self._read(socket, self.revisions[number]))
            stack.callback(reader.cancel)

    async def _read(self, socket: ClientConnection, revisions: dict[str, int]) -> None:
        async for text in socket:
            told = json.loads(text)
            for feature in [told["obstacle"]] if "obstacle" in told else told.get("obstacles", []):
                assert feature["properties"]["revision"] >= revisions.get(feature["id"], 0)
                revisions[feature["id"]] = feature["properties"]["revision"]


async def _reported(client: httpx.AsyncClient, rounds: int, seed: int) -> dict[str, int]:
    """Changes of many obstacles; the last revision of each."""
    chance, last = random.Random(seed), {}  # noqa: S311
    places = [(20.0 * east, 20.0 * north) for east in range(-3, 4) for north in range(-3, 4)]
    for number in range(rounds):
        # Sizes that alternate make every sighting a change of what is served.
        seen = [detection(*place, 1000 + 500 * (number % 2)) for place in chance.sample(places, 8)]
        report = message(*seen, vehicle=f"v{number}", at=datetime.now(UTC) - HOUR, number=number)
        body = ObservationBatch(sent_at=datetime.now(UTC), reports=(report,)).model_dump_json()
        answer = await client.post("/v1/observations", content=body, headers=JSON)
        assert answer.status_code == 200, answer.text
        for item in answer.json()["results"][0]["detections"]:
            last[item["obstacle_id"]] = item["revision"]
    return last


async def _told_all(crowd: _Crowd, last: dict[str, int], within_s: float) -> None:
    """Wait until every vehicle that reads knows every obstacle's last revision."""
    async with asyncio.timeout(within_s):
        while any(  # noqa: ASYNC110  # the readers are many, and each may be the last
            known.get(identifier, 0) < revision
            for known in crowd.revisions.values()
            for identifier, revision in last.items()
        ):
            await asyncio.sleep(0.1)


async def _crowded(server: ServerProcess, readers: int, silent: int, rounds: int) -> int:
    """Bytes that the server has grown by when everybody who reads has been told everything."""
    crowd = _Crowd(server)
    async with httpx.AsyncClient(base_url=server.url, trust_env=False, timeout=60) as client, AsyncExitStack() as stack:
        before_bytes = server.resident_bytes
        for number in range(readers + silent):
            await crowd.joined(stack, number < readers, number)
        last = await _reported(client, rounds, seed=1)
        await _told_all(crowd, last, within_s=60)
        assert (await client.get("/readyz")).status_code == 200
        return server.resident_bytes - before_bytes


@pytest.mark.soak
def test_vehicles_that_never_read_delay_nobody(tmp_path: Path) -> None:
    with serving_processes(f"sqlite+aiosqlite:///{tmp_path}/headsup.sqlite3") as (server,):
        asyncio.run(_crowded(server, readers=5, silent=5, rounds=30))


@pytest.mark.soak
def test_two_hundred_vehicles_of_which_fifty_never_read(database_url: str) -> None:
    with serving_processes(database_url) as (server,):
        grown_bytes = asyncio.run(_crowded(server, readers=150, silent=50, rounds=150))
    print(f"200 sockets, 50 of them silent, 150 reports of 8: grown by {grown_bytes / 2**20:.1f} MiB")
    assert grown_bytes < 200 * _SOCKET_BYTES + _SLACK_BYTES
