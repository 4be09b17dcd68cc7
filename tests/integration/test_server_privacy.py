"""What an outsider may see: obstacles, and nothing that tells one vehicle from another."""

from __future__ import annotations

import asyncio
from datetime import datetime
from pathlib import Path
from typing import Any
from uuid import UUID

import httpx
import pytest
from pydantic import SecretStr
from sqlalchemy import select

from contract.events import Position, ServerMessage
from contract.geometry import LatLon
from server.formats.denm import action_id
from server.formats.names import FormatName
from server.push.stream import Subscription
from server.settings import Settings
from server.storage import tables
from server.storage.database import Database
from server.trust.keys import Role
from tests.integration.asking import AROUND_PATRAS, ago, created, posted
from tests.integration.conftest import OPERATOR_KEY
from tests.integration.keys_of import bearer, client_of, keyed, opened
from tests.unit.server.making import PATRAS, absent, detection, message


@pytest.fixture
def guarded_sqlite(tmp_path: Path) -> Settings:
    return Settings(
        database_url=f"sqlite+aiosqlite:///{tmp_path}/headsup.sqlite3", bootstrap_operator_key=SecretStr(OPERATOR_KEY)
    )


async def names_of_vehicles(database: Database) -> set[str]:
    """Everything in the database that stands for a vehicle or comes from one alone."""
    found: set[str] = set()
    async with database.read() as connection:
        for column in (
            tables.api_key.c.id,
            tables.api_key.c.name,
            tables.api_key.c.sha256,
            tables.witness.c.name,
            tables.creation.c.witness,
            tables.report.c.report_id,
            tables.report.c.body_sha256,
            tables.secret.c.value,
        ):
            found |= {str(value) for value in (await connection.execute(select(column))).scalars()}
    return found


async def seen_by_a_reader(client: httpx.AsyncClient, ids: list[UUID]) -> list[str]:
    """The text of every answer a reader can get about these obstacles."""
    paths = [f"/v1/obstacles/{identifier}{part}" for identifier in ids for part in ("", "/history", "/points")]
    paths += [f"/v1/obstacles/{identifier}?f={name.value}" for identifier in ids for name in FormatName]
    paths += [f"/v1/obstacles?lat=38.2466&lon=21.7346&f={name.value}" for name in FormatName]
    paths += ["/ogc/collections/obstacles/items?limit=100", "/v1/obstacles?bbox=21,38,22,39&state=removed"]
    answers = [await client.get(path) for path in paths]
    assert {answer.status_code for answer in answers} == {200}
    return [answer.text + repr(sorted(answer.headers.items())) for answer in answers]


async def test_no_answer_and_no_event_names_a_vehicle(guarded_sqlite: Settings) -> None:
    pushed: asyncio.Queue[str] = asyncio.Queue()

    async def send(item: ServerMessage) -> None:
        await pushed.put(item.model_dump_json())

    async with opened(guarded_sqlite) as app, client_of(app) as vehicle, client_of(app) as reader:
        parts = app.state.parts
        first, second, onlooker = await keyed(app, Role.VEHICLE, Role.VEHICLE, Role.READER)
        subscription = Subscription(parts.service.near, send)
        subscription.move(Position(position_seq=1, position=PATRAS, radius_m=1_000))
        vehicle.headers.update(bearer(first))
        ids = await created(vehicle, message(detection(0, 0), detection(30, 0), at=ago(5), vehicle="pseudonym-one"))
        vehicle.headers.update(bearer(second))
        parts.hub.add(subscription)
        pushing = asyncio.create_task(subscription.run())
        texts = [await asyncio.wait_for(pushed.get(), 10)]
        await posted(vehicle, message(detection(0, 0, 1_500), at=ago(3), vehicle="pseudonym-two", number=1))
        await posted(vehicle, message(inspections=(absent(ids[1]),), at=ago(2.9), vehicle="pseudonym-two", number=2))
        await reader.post(f"/v1/obstacles/{ids[0]}/actions", json={"action": "confirm"}, headers=bearer(OPERATOR_KEY))
        reader.headers.update(bearer(onlooker))
        texts += [await asyncio.wait_for(pushed.get(), 10) for _ in range(2)]
        pushing.cancel()
        texts += await seen_by_a_reader(reader, ids)
        hidden = await names_of_vehicles(parts.database)
    hidden |= {"pseudonym-one", "pseudonym-two", "lidar-64", "moment-box-1", "bootstrap", first, second}
    assert len(hidden) > 15
    for text in texts:
        assert not [name for name in hidden if name in text]


async def test_the_same_obstacles_look_the_same_whoever_reported_them(tmp_path: Path) -> None:
    at = ago(2)
    told = [await as_served(tmp_path / f"{turn}.sqlite3", at, turn) for turn in range(2)]
    assert told[0] == told[1]


async def as_served(path: Path, at: datetime, turn: int) -> list[dict[str, Any]]:
    """What is served of two obstacles, each reported by one of two vehicles, which are exchanged at turn 1."""
    settings = Settings(database_url=f"sqlite+aiosqlite:///{path}", bootstrap_operator_key=SecretStr(OPERATOR_KEY))
    async with opened(settings) as app, client_of(app) as client:
        keys = await keyed(app, Role.VEHICLE, Role.VEHICLE)
        for number in range(2):
            client.headers.update(bearer(keys[(number + turn) % 2]))
            place = LatLon(latitude_deg=PATRAS.latitude_deg + 0.002 * number, longitude_deg=PATRAS.longitude_deg)
            await created(client, message(detection(), at=at, position=place, vehicle=f"car{turn}", number=number))
        features = (await client.get("/v1/obstacles", params=AROUND_PATRAS)).json()["features"]
    return [{"geometry": feature["geometry"], "properties": feature["properties"]} for feature in features]


async def test_a_denm_comes_from_a_station_of_the_obstacle_and_not_of_the_vehicle(guarded_sqlite: Settings) -> None:
    async with opened(guarded_sqlite) as app, client_of(app) as client:
        (key,) = await keyed(app, Role.VEHICLE)
        client.headers.update(bearer(key))
        ids = await created(client, message(*(detection(20 * n, 0) for n in range(5)), at=ago(2)))
        stations = set()
        for identifier in ids:
            header = (await client.get(f"/v1/obstacles/{identifier}?f=denm")).json()["header"]
            assert header["stationID"] == action_id(identifier)[0]
            stations.add(header["stationID"])
    assert len(stations) == len(ids)
