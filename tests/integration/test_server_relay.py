"""Vehicles on one server hear of what others report to another server on the same database."""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import dataclass
from datetime import UTC, datetime

import pytest
from sqlalchemy import delete
from websockets.asyncio.client import ClientConnection

from contract.events import Appeared, Moved, Removed, Snapshot
from server.settings import Settings
from server.storage import tables
from server.web.dependencies import Parts
from tests.integration.conftest import OPERATOR_KEY
from tests.integration.raw import served_here
from tests.integration.test_server_events import Running, at, received, seen
from tests.unit.server.making import HOUR, absent, message


@dataclass(frozen=True)
class Two:
    """Two servers on one database; the vehicle is connected to the first."""

    here: Running
    there: Running
    parts: Parts


@pytest.fixture
async def two(guarded: Settings) -> AsyncIterator[Two]:
    async with served_here(guarded) as (app, here), served_here(guarded) as (other, there):
        yield Two(Running(here, app.state.parts.keys), Running(there, other.state.parts.keys), app.state.parts)


@pytest.fixture
def by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is relayed but when a test does it."""
    monkeypatch.setattr("server.push.relay._INTERVAL_S", 3_600.0)


async def connected(socket: ClientConnection) -> None:
    await socket.send(at(1))
    assert isinstance(await received(socket), Snapshot)


async def hears_nothing(socket: ClientConnection) -> None:
    """Whatever was to be told comes before the answer to the next position."""
    await socket.send(at(2))
    assert isinstance(await received(socket), Moved)


async def test_what_one_server_is_told_vehicles_on_another_hear(two: Two) -> None:
    async with two.here.connect(OPERATOR_KEY) as socket:
        await connected(socket)
        await two.there.post(seen(30))
        appeared = await received(socket)
        assert isinstance(appeared, Appeared)
        await two.there.post(message(inspections=(absent(appeared.obstacle.id),), at=datetime.now(UTC) - HOUR))
        removed = await received(socket)
        assert isinstance(removed, Removed)
        assert (removed.obstacle_id, removed.reason) == (appeared.obstacle.id, "absent")


@pytest.mark.usefixtures("by_hand")
async def test_what_a_server_has_told_by_itself_it_does_not_tell_again(two: Two) -> None:
    async with two.here.connect(OPERATOR_KEY) as socket:
        await connected(socket)
        await two.here.post(seen(-30))
        assert isinstance(await received(socket), Appeared)
        await two.parts.relay.tell()
        await hears_nothing(socket)


@pytest.mark.usefixtures("by_hand")
async def test_what_happens_elsewhere_on_another_server_is_not_told(two: Two) -> None:
    async with two.here.connect(OPERATOR_KEY) as socket:
        await connected(socket)
        await two.there.post(seen(400))
        await two.parts.relay.tell()
        await hears_nothing(socket)


@pytest.mark.usefixtures("by_hand")
async def test_a_vehicle_for_which_the_log_is_too_short_gets_all_that_is_there(two: Two) -> None:
    async with two.here.connect(OPERATOR_KEY) as socket:
        await connected(socket)
        await two.there.post(seen(30))
        async with two.parts.database.write() as connection:
            await connection.execute(delete(tables.event))
        await two.parts.relay.tell()
        told = await received(socket)
        assert isinstance(told, Snapshot)
        assert len(told.obstacles) == 1
