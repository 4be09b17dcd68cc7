"""Hostile requests by the thousand: no fault of the server's own, and no memory that stays."""

from __future__ import annotations

import asyncio
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

import httpx
import pytest

from contract.observation import ObservationBatch
from tests.integration.asking import JSON
from tests.integration.hostile import Hostile, status_of
from tests.integration.processes import ServerProcess, serving_processes
from tests.unit.server.making import HOUR, detection, message

# Caches of statements and parsers fill within the first thousands; what grows after that, grows for ever.
_GROWTH_BYTES = 24 << 20
# For requests that never end. An answer that takes longer shows as none, of which there must be few.
_PATIENCE_S = 3.0
# Some hostile requests carry keys: their limit is another test's.
_NO_LIMIT = {"HEADSUP_FAILED_KEYS_PER_MINUTE": "1e9"}


async def _attacked(port: int, number: int, seed: int) -> Counter[int]:
    """Statuses of so many hostile requests, eight at a time."""
    hostile, statuses = Hostile(seed), Counter[int]()
    waiting = iter(range(number))

    async def attacker() -> None:
        for _ in waiting:
            request = hostile.request()
            status = await status_of(port, request, _PATIENCE_S)
            statuses[status] += 1
            assert status not in (500, 502, 504), request[:2_000]

    await asyncio.gather(*(attacker() for _ in range(8)))
    return statuses


def _still_serves(server: ServerProcess) -> None:
    report = message(detection(), at=datetime.now(UTC) - HOUR)
    body = ObservationBatch(sent_at=datetime.now(UTC), reports=(report,)).model_dump_json()
    with httpx.Client(base_url=server.url, trust_env=False) as client:
        assert client.post("/v1/observations", content=body, headers=JSON).json()["results"][0]["status"] in (
            "accepted",
            "duplicate",
        )
        assert client.get("/v1/obstacles?lat=38.2466&lon=21.7346").json()["features"]


def test_five_hundred_hostile_requests_are_refused_and_the_server_serves_on(tmp_path: Path) -> None:
    with serving_processes(f"sqlite+aiosqlite:///{tmp_path}/headsup.sqlite3", **_NO_LIMIT) as (server,):
        statuses = asyncio.run(_attacked(server.port, 500, seed=1))
        _still_serves(server)
    assert {200, 400, 404, 413, 415, 422} <= set(statuses), "the requests were not as hostile as they should be"
    assert statuses[0] < 0.2 * statuses.total(), statuses


@pytest.mark.soak
def test_ten_thousand_hostile_requests_leave_no_memory_behind(database_url: str) -> None:
    with serving_processes(database_url, **_NO_LIMIT) as (server,):
        statuses = asyncio.run(_attacked(server.port, 4_000, seed=2))
        before_bytes = server.resident_bytes
        statuses += asyncio.run(_attacked(server.port, 6_000, seed=3))
        grown_bytes = server.resident_bytes - before_bytes
        _still_serves(server)
    print(
        f"{sum(statuses.values())} requests: {dict(sorted(statuses.items()))}, grown by {grown_bytes / 2**20:.1f} MiB"
    )
    assert grown_bytes < _GROWTH_BYTES


async def _drip(port: int, seconds: float) -> None:
    """A body of single bytes, never finished."""
    _, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(
        b"POST /v1/observations HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nContent-Length: 900000\r\n\r\n"
    )
    try:
        async with asyncio.timeout(seconds):
            while True:
                writer.write(b"[")
                await writer.drain()
                await asyncio.sleep(0.05)
    except TimeoutError:
        pass
    finally:
        writer.close()


@pytest.mark.soak
def test_bodies_that_drip_hold_up_nobody_and_cost_little(tmp_path: Path) -> None:
    async def attacked(server: ServerProcess) -> list[float]:
        drips = [asyncio.create_task(_drip(server.port, 3.0)) for _ in range(50)]
        waits_s = []
        async with httpx.AsyncClient(base_url=server.url, trust_env=False, timeout=20) as client:
            for _ in range(10):
                begun_s = asyncio.get_running_loop().time()
                assert (await client.get("/v1/obstacles?lat=38.2466&lon=21.7346")).status_code == 200
                waits_s.append(asyncio.get_running_loop().time() - begun_s)
        await asyncio.gather(*drips)
        return waits_s

    with serving_processes(f"sqlite+aiosqlite:///{tmp_path}/headsup.sqlite3", **_NO_LIMIT) as (server,):
        before_bytes = server.resident_bytes
        assert len(asyncio.run(attacked(server))) == 10
        assert server.resident_bytes - before_bytes < _GROWTH_BYTES
