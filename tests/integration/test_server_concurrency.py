"""Many writers at several servers on one database: an obstacle is created once, and every sighting counts."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import pytest

from contract.geometry import LatLon
from contract.observation import ObservationReport
from server.geometry.quadkey import tiles
from tests.integration.conftest import upgraded
from tests.integration.invariants import assert_consistent, stored
from tests.integration.load import Tally, settle
from tests.integration.processes import KillablePostgres, killable_postgres, serving_processes
from tests.unit.server.making import detection, message

CORNER = LatLon(latitude_deg=0.0, longitude_deg=0.0)
LEVELS = ["read committed", "repeatable read", "serializable"]
# Evidence of one key less than this apart is one pass.
_PASS = timedelta(minutes=11)


@pytest.fixture(scope="module")
def own_postgres() -> Iterator[KillablePostgres]:
    with killable_postgres() as postgres:
        yield postgres


def _passes(vehicles: int, each: int, seed: int) -> list[ObservationReport]:
    """Passes of vehicles over one hole at the corner of four tiles, in any order."""
    chance = random.Random(seed)  # noqa: S311
    now = datetime.now(UTC)
    reports = [
        message(
            detection(chance.gauss(0, 0.2), chance.gauss(0, 0.2)),
            vehicle=f"v{vehicle}",
            at=now - timedelta(minutes=5) - passage * _PASS,
            number=passage,
            position=CORNER,
        )
        for vehicle in range(vehicles)
        for passage in range(each)
    ]
    chance.shuffle(reports)
    return reports


async def _written(urls: list[str], reports: list[ObservationReport], retries: int, writers: int, seed: int) -> Tally:
    """All reports, a part of them twice and at other servers, by so many writers at once."""
    chance, tally = random.Random(seed), Tally()  # noqa: S311
    sent = reports + chance.sample(reports, retries)
    chance.shuffle(sent)
    clients = [httpx.AsyncClient(base_url=url, trust_env=False, timeout=30) for url in urls]
    try:
        # An answer that comes first may be that of a repetition: `send` compares with the same report's first answer.
        await settle(clients, sent, writers, tally)
    finally:
        for client in clients:
            await client.aclose()
    return tally


def _assert_one_obstacle_and_every_sighting(url: str, tally: Tally, reports: list[ObservationReport]) -> None:
    found = stored(url)
    assert_consistent(found)
    assert [(row["sightings"], row["state"]) for row in found.obstacles] == [(len(reports), "confirmed")]
    assert set(tally.answers) == {str(report.report_id) for report in reports} == set(found.answers)
    decisions = [answer.detections[0].decision for answer in found.answers.values()]
    assert decisions.count("created") == 1
    assert set(decisions) <= {"created", "kept", "updated"}


def _converges(url: str, servers: int, vehicles: int, each: int, writers: int) -> tuple[Tally, float]:
    assert len(tiles(CORNER, 100)) == 4
    reports = _passes(vehicles, each, seed=3)
    with serving_processes(url, servers) as running:
        begun_s = time.monotonic()
        urls = [server.url for server in running]
        tally = asyncio.run(_written(urls, reports, len(reports) // 4, writers, seed=4))
        took_s = time.monotonic() - begun_s
    _assert_one_obstacle_and_every_sighting(url, tally, reports)
    return tally, took_s


def _at_level(postgres: KillablePostgres, level: str) -> str:
    url = postgres.fresh_url()
    asyncio.run(upgraded(url))
    name = url.rpartition("/")[2].partition("?")[0]
    postgres.psql(f"ALTER DATABASE {name} SET default_transaction_isolation = '{level}';")
    return url


@pytest.mark.soak
def test_two_servers_at_serializable_create_an_obstacle_at_a_tile_corner_once(own_postgres: KillablePostgres) -> None:
    _converges(_at_level(own_postgres, "serializable"), servers=2, vehicles=8, each=5, writers=12)


@pytest.mark.soak
@pytest.mark.parametrize("level", LEVELS)
def test_fifty_writers_at_two_servers_lose_nothing_at_any_isolation_level(
    own_postgres: KillablePostgres, level: str
) -> None:
    before = own_postgres.log
    tally, took_s = _converges(_at_level(own_postgres, level), servers=2, vehicles=50, each=12, writers=50)
    since = own_postgres.log[len(before) :]
    serialization, deadlocks = since.count("could not serialize"), since.count("deadlock detected")
    unique = since.count("duplicate key value")
    print(
        f"{level}: {took_s:.1f} s, {dict(tally.statuses)}, retried inside: {serialization} serialization failures, "
        f"{deadlocks} deadlocks, {unique} unique violations"
    )


@pytest.mark.soak
def test_fifty_writers_at_four_processes_on_one_sqlite_file_lose_nothing(tmp_path: Path) -> None:
    url = f"sqlite+aiosqlite:///{tmp_path}/headsup.sqlite3"
    asyncio.run(upgraded(url))
    tally, took_s = _converges(url, servers=4, vehicles=50, each=12, writers=50)
    print(f"SQLite, four processes: {took_s:.1f} s, {dict(tally.statuses)}")
