"""Servers and databases that are killed under load: nothing answered is lost, nothing counts twice."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, suppress

import httpx
import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosedError
from websockets.frames import CloseCode

from contract.events import SUBPROTOCOL, Moved, Position, Snapshot, server_message
from contract.observation import ObservationReport
from tests.integration.conftest import upgraded
from tests.integration.invariants import assert_consistent, stored
from tests.integration.load import Tally, assert_is_a_polite_refusal, fleet_reports, send, settle
from tests.integration.processes import KillablePostgres, ServerProcess, killable_postgres, serving_processes
from tests.unit.server.making import PATRAS

_READS = (
    "/readyz",
    "/v1/obstacles?lat=38.2466&lon=21.7346&radius_m=300",
    "/v1/obstacles?lat=38.2466&lon=21.7346&radius_m=300&f=geojson",
    "/v1/actions",
    "/ogc/collections/obstacles/items",
)
# A read gives up after 10 s, then needs 2 s to drop its connection; the rest is a busy machine.
_NO_HANG_S = 25.0


@pytest.fixture(scope="module")
def durable_postgres() -> Iterator[KillablePostgres]:
    with killable_postgres() as postgres:
        yield postgres


async def _load_until_killed(
    server: ServerProcess, reports: list[ObservationReport], tally: Tally, after_s: float
) -> list[ObservationReport]:
    """Eight vehicles report until the server dies, `after_s` from now; the reports that nobody answered."""

    async def vehicle(mine: list[ObservationReport]) -> None:
        for report in mine:
            if await send(client, report, tally) is None:
                return

    async with httpx.AsyncClient(base_url=server.url, trust_env=False, timeout=10) as client:
        vehicles = [asyncio.create_task(vehicle(reports[index::8])) for index in range(8)]
        await asyncio.sleep(after_s)
        await asyncio.to_thread(server.kill)
        await asyncio.gather(*vehicles)
    return [report for report in reports if str(report.report_id) not in tally.answers]


async def _retried(server: ServerProcess, reports: list[ObservationReport], tally: Tally) -> None:
    async with httpx.AsyncClient(base_url=server.url, trust_env=False, timeout=20) as client:
        await settle([client], reports, 4, tally)


def _killed(database_url: str, moments: int, reports_each: int, seed: int) -> Tally:
    """Kill a server at random moments under load; what the vehicles were told."""
    chance, tally = random.Random(seed), Tally()  # noqa: S311
    unanswered: list[ObservationReport] = []
    with serving_processes(database_url) as (server,):
        for moment in range(moments):
            reports = [*unanswered, *fleet_reports(seed + moment, reports_each)]
            unanswered = asyncio.run(_load_until_killed(server, reports, tally, chance.uniform(0.1, 1.0)))
            server.start()
            again = [report for report in reports if str(report.report_id) in tally.answers]
            # Whoever asks again is told what was told before the kill (`send` compares).
            asyncio.run(_retried(server, chance.sample(again, min(5, len(again))), tally))
        asyncio.run(_retried(server, unanswered, tally))
    return tally


def _assert_nothing_lost_or_twice(database_url: str, tally: Tally) -> None:
    found = stored(database_url)
    assert_consistent(found)
    logged = found.answers
    assert {name: logged.get(name) for name in tally.answers} == tally.answers
    assert found.sightings == found.counted_detections == len(logged)


def test_a_server_killed_under_load_loses_nothing_it_answered(database_url: str) -> None:
    tally = _killed(database_url, 1, 40, seed=1)
    _assert_nothing_lost_or_twice(database_url, tally)


@pytest.mark.soak
def test_at_twenty_five_random_moments_of_each_engine(database_url: str) -> None:
    begun_s = time.monotonic()
    tally = _killed(database_url, 25, 100, seed=100)
    _assert_nothing_lost_or_twice(database_url, tally)
    print(f"25 kills, {len(tally.answers)} answered, {dict(tally.statuses)}, {time.monotonic() - begun_s:.0f} s")


async def _read_until(stop: asyncio.Event, client: httpx.AsyncClient, path: str, tally: Tally) -> None:
    while not stop.is_set():
        begun_s = time.monotonic()
        answer = await client.get(path)
        tally.slowest_s = max(tally.slowest_s, time.monotonic() - begun_s)
        tally.statuses[answer.status_code] += 1
        if answer.status_code != 200:
            assert_is_a_polite_refusal(answer)
        await asyncio.sleep(0.05)


@asynccontextmanager
async def _subscribed(server: ServerProcess) -> AsyncIterator[ClientConnection]:
    """A vehicle that connects now gets its snapshot."""
    url = f"ws://127.0.0.1:{server.port}/v1/events"
    async with connect(url, subprotocols=[SUBPROTOCOL], proxy=None) as socket:
        await socket.send(_position(1))
        assert isinstance(server_message.validate_json(await asyncio.wait_for(socket.recv(), 20)), Snapshot)
        yield socket


async def _drives_on(socket: ClientConnection) -> None:
    """A vehicle that moves during an outage is acknowledged in the end, or told to come back."""
    await socket.send(_position(2))
    async with asyncio.timeout(_NO_HANG_S):
        with suppress(ConnectionClosedError):
            async for text in socket:
                told = server_message.validate_json(text)
                if isinstance(told, Moved) and told.position_seq == 2:
                    return
    assert socket.close_code == CloseCode.TRY_AGAIN_LATER


def _position(seq: int) -> str:
    return Position(position_seq=seq, position=PATRAS, radius_m=300 + seq).model_dump_json()


async def _through_an_outage(
    server: ServerProcess, postgres: KillablePostgres, reports: list[ObservationReport], outage_s: float, frozen: bool
) -> tuple[Tally, Tally]:
    """Write and read through an outage of the database; every refusal is polite, and all recovers by itself."""
    writes, reads, stop = Tally(), Tally(), asyncio.Event()
    async with (
        httpx.AsyncClient(base_url=server.url, trust_env=False, timeout=_NO_HANG_S) as client,
        AsyncExitStack() as stack,
    ):
        connected = await stack.enter_async_context(_subscribed(server))
        readers = [asyncio.create_task(_read_until(stop, client, path, reads)) for path in _READS]
        writer = asyncio.create_task(settle([client], reports, 4, writes))
        await asyncio.sleep(0.5)
        if frozen:
            with postgres.frozen():
                await asyncio.gather(asyncio.sleep(outage_s), _drives_on(connected))
        else:
            await asyncio.to_thread(postgres.kill)
            await asyncio.gather(asyncio.sleep(outage_s), _drives_on(connected))
            await asyncio.to_thread(postgres.start)
        await writer
        await stack.enter_async_context(_subscribed(server))
        stop.set()
        await asyncio.gather(*readers)
        # What was accepted before is known after, also to those who ask again.
        await settle([client], reports[:5], 1, writes)
        for path in _READS:
            assert (await client.get(path)).status_code == 200, path
    return writes, reads


@pytest.mark.parametrize(
    ("frozen", "outage_s", "number"),
    [
        pytest.param(False, 1.0, 30),
        pytest.param(False, 8.0, 600, marks=pytest.mark.soak),
        pytest.param(True, 20.0, 300, marks=pytest.mark.soak),
    ],
    ids=["killed", "killed under load", "standing still"],
)
def test_an_outage_of_the_database_is_answered_503_and_leaves_no_trace(
    durable_postgres: KillablePostgres, frozen: bool, outage_s: float, number: int
) -> None:
    url = durable_postgres.fresh_url()
    asyncio.run(upgraded(url))
    reports = fleet_reports(7, number)
    with serving_processes(url, HEADSUP_WRITE_DEADLINE_S="2") as (server,):
        writes, reads = asyncio.run(_through_an_outage(server, durable_postgres, reports, outage_s, frozen))
    _assert_nothing_lost_or_twice(url, writes)
    assert set(writes.statuses) == {200, 503} or set(reads.statuses) == {200, 503}, "the outage was not noticed"
    assert max(writes.slowest_s, reads.slowest_s) < _NO_HANG_S
    assert len(writes.answers) == number
    print(
        f"writes {dict(writes.statuses)} {writes.slowest_s:.1f} s, reads {dict(reads.statuses)} {reads.slowest_s:.1f} s"
    )
