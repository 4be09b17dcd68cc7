"""A query begun after an answered write sees it, at every server; and both ways of answering say the same."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any
from uuid import UUID

import httpx
import pytest
from hypothesis import HealthCheck, assume, example, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from contract.geometry import LatLon
from contract.obstacle import ObstacleFeature
from server.geometry.geodesy import offset_from
from server.settings import Settings
from tests.integration.asking import JSON, by_sql, posted
from tests.integration.conftest import serving
from tests.integration.processes import serving_processes
from tests.unit.server.making import PATRAS, absent, detection, message

CORNER = LatLon(latitude_deg=0.0, longitude_deg=0.0)
ANTIMERIDIAN = LatLon(latitude_deg=-16.8, longitude_deg=180.0)
NORTH = LatLon(latitude_deg=84.0, longitude_deg=30.0)
CENTRES = (CORNER, ANTIMERIDIAN, NORTH, PATRAS)


@dataclass
class _Writer:
    """Writes at servers in turn, and knows what a reader must be told from then on."""

    clients: list[httpx.AsyncClient]
    chance: random.Random
    expected: dict[UUID, int] = field(default_factory=dict)
    """Revisions of live obstacles as answered; -1 for removed ones."""
    places: list[tuple[float, float]] = field(default_factory=list)
    number: int = 0

    async def sighting(self) -> None:
        """A new obstacle, or another look at one: bigger, or from across the border of its tile."""
        if len(self.places) < 12 or self.chance.random() < 0.05:
            place = (self.chance.uniform(-150, 150), self.chance.uniform(-150, 150))
            if any(abs(place[0] - x) + abs(place[1] - y) < 25 for x, y in self.places):
                return
            self.places.append(place)
        east_m, north_m = self.chance.choice(self.places)
        # Obstacles within metres of the corner wander to another tile as they are seen again.
        seen = detection(
            east_m + self.chance.gauss(0, 1), north_m + self.chance.gauss(0, 1), self.chance.choice((1000, 1300, 1600))
        )
        (result,) = await posted(self._client(), self._message(seen))
        for item in result.detections:
            if item.obstacle_id is not None and item.revision is not None:
                self.expected[item.obstacle_id] = -1 if item.state == "removed" else item.revision

    async def removal(self) -> None:
        """An operator has a hole filled."""
        live = [identifier for identifier, revision in self.expected.items() if revision > 0]
        if not live:
            return
        identifier = self.chance.choice(live)
        done = await self._client().post(
            f"/v1/obstacles/{identifier}/actions", content='{"action":"repaired"}', headers=JSON
        )
        assert done.status_code == 200, done.text
        self.expected[identifier] = -1

    async def inspection(self) -> None:
        """A vehicle does not find what it was told of."""
        live = [identifier for identifier, revision in self.expected.items() if revision > 0]
        if not live:
            return
        identifier = self.chance.choice(live)
        await posted(self._client(), self._message(inspections=(absent(identifier),)))
        feature = ObstacleFeature.model_validate_json((await self._client().get(f"/v1/obstacles/{identifier}")).content)
        self.expected[identifier] = -1 if feature.properties.state == "removed" else feature.properties.revision

    def _message(self, *detections: Any, **about: Any) -> Any:
        self.number += 1
        at = datetime.now(UTC) - timedelta(seconds=30)
        return message(*detections, vehicle=f"w{self.number}", number=self.number, at=at, position=CORNER, **about)

    def _client(self) -> httpx.AsyncClient:
        return self.chance.choice(self.clients)


async def _checked(writer: _Writer, centre: LatLon, radius_m: float) -> None:
    """Every server tells what was answered, from memory."""
    for client in writer.clients:
        query = {"lat": centre.latitude_deg, "lon": centre.longitude_deg, "radius_m": radius_m}
        answer = await client.get("/v1/obstacles", params=query)
        assert answer.status_code == 200, answer.text
        told = {UUID(item["id"]): item["properties"]["revision"] for item in answer.json()["features"]}
        missing = {
            identifier: (revision, told.get(identifier))
            for identifier, revision in writer.expected.items()
            if (told.get(identifier, -1) < revision if revision > 0 else identifier in told)
        }
        # What merged into another is removed by a report that was answered about the other.
        for identifier in list(missing):
            single = (await client.get(f"/v1/obstacles/{identifier}")).json()
            if single["properties"]["merged_into"] is not None and identifier not in told:
                writer.expected[identifier] = -1
                del missing[identifier]
        assert not missing, f"answered and told: {missing}"


async def _reads_see_writes(urls: list[str], rounds: int, seed: int) -> int:
    clients = [httpx.AsyncClient(base_url=url, trust_env=False, timeout=30) for url in urls]
    writer = _Writer(clients, random.Random(seed))  # noqa: S311
    try:
        for _ in range(rounds):
            turn = writer.chance.random()
            await (writer.removal() if turn < 0.04 else writer.inspection() if turn < 0.1 else writer.sighting())
            centre = offset_from(CORNER, writer.chance.uniform(-50, 50), writer.chance.uniform(-50, 50))
            await _checked(writer, centre, 400.0)
    finally:
        for client in clients:
            await client.aclose()
    return len(writer.expected)


async def test_a_query_after_an_answered_write_sees_it_at_every_server(settings: Settings) -> None:
    async with serving(settings) as one, serving(settings) as other:
        writer = _Writer([one, other], random.Random(5))  # noqa: S311
        for _ in range(60):
            turn = writer.chance.random()
            await (writer.removal() if turn < 0.1 else writer.inspection() if turn < 0.2 else writer.sighting())
            await _checked(writer, offset_from(CORNER, writer.chance.uniform(-50, 50), 0.0), 400.0)


@pytest.mark.soak
def test_thousands_of_times_at_two_processes(database_url: str) -> None:
    with serving_processes(database_url, 2) as servers:
        obstacles = asyncio.run(_reads_see_writes([server.url for server in servers], rounds=800, seed=6))
    print(f"800 writes, each read at both, {obstacles} obstacles")


def _texts(low: float, high: float) -> st.SearchStrategy[str]:
    """Numbers as callers write them, also oddly."""
    numbers = st.floats(low, high).map(repr) | st.floats(low, high).map(lambda x: f"{x:.6f}")
    odd = st.sampled_from(
        ["", "nan", "inf", "-inf", "1_0", "+1", " 1", "1 ", "0x1", "1e1", "1.", ".5", "00", "-0", "1e400"]
    )
    return numbers | odd


_LIMITS = st.sampled_from(["1", "2", "5", "1000", "0", "1001", "+5", "5.0", "1_0", "", " 3", "-1", "٣"])


@st.composite
def _queries(draw: st.DrawFn) -> str:
    """Circles around and beside the obstacles, mostly right ones."""
    if draw(st.integers(0, 9)) == 0:
        latitude, longitude = draw(_texts(-90, 90)), draw(_texts(-180, 180))
    else:
        centre = draw(st.sampled_from(CENTRES))
        place = offset_from(centre, draw(st.floats(-600, 600)), draw(st.floats(-600, 600)))
        latitude, longitude = repr(place.latitude_deg), repr(place.longitude_deg)
    parts = [f"lat={latitude}", f"lon={longitude}"]
    if draw(st.booleans()):
        parts.append(f"radius_m={draw(st.floats(0.001, 2100).map(repr) | _texts(0, 3000))}")
    if draw(st.booleans()):
        parts.append(f"limit={draw(_LIMITS)}")
    return "&".join(draw(st.permutations(parts)))


@pytest.fixture
def populated(settings: Settings) -> Iterator[tuple[asyncio.Runner, httpx.AsyncClient]]:
    """A server with obstacles at a tile corner, across the antimeridian, far north, and some removed ones."""
    with asyncio.Runner() as runner:
        context = serving(settings)
        client = runner.run(context.__aenter__())
        runner.run(_populated(client))
        yield runner, client
        runner.run(context.__aexit__(None, None, None))


async def _populated(client: httpx.AsyncClient) -> None:
    now = datetime.now(UTC)
    chance = random.Random(9)  # noqa: S311
    for turn, centre in enumerate(CENTRES):
        for number in range(6):
            places = [(chance.uniform(-290, 290), chance.uniform(-290, 290)) for _ in range(3)]
            origin = offset_from(centre, chance.uniform(-300, 300), chance.uniform(-300, 300))
            near = [(x / 4, y / 4) for x, y in places]
            await posted(
                client,
                message(
                    *(detection(x, y) for x, y in near),
                    vehicle=f"p{turn}-{number}",
                    number=number,
                    at=now - timedelta(hours=1, minutes=number),
                    position=origin,
                ),
            )


def test_the_answer_from_memory_is_that_of_the_typed_route_byte_for_byte(
    populated: tuple[asyncio.Runner, httpx.AsyncClient],
) -> None:
    runner, client = populated
    answered = []

    @hypothesis_settings(
        max_examples=150, deadline=None, database=None, derandomize=True, suppress_health_check=list(HealthCheck)
    )
    @given(query=_queries())
    @example(query="lat=0&lon=0&radius_m=1_0")
    @example(query="lat=0&lon=0&limit=1_0")
    @example(query="lat=0&lon=0&radius_m=+100")
    @example(query="lat=0&lon=180&lat=0")
    @example(query="lat=-16.8&lon=-180&radius_m=2000")
    def same(query: str) -> None:
        quick, typed = runner.run(_both(client, query))
        assert quick.status_code == typed.status_code, (query, quick.text[:300], typed.text[:300])
        assume(quick.status_code == 200)
        # Links repeat the query, and with it the parameter that chose the typed route.
        assert quick.json()["features"] == typed.json()["features"]
        if "links" not in typed.json():
            assert (quick.content, quick.headers["etag"]) == (typed.content, typed.headers["etag"])
            assert typed.json()["features"] == runner.run(by_sql(client, **httpx.QueryParams(query)))
        answered.append(len(typed.json()["features"]))

    same()
    assert max(answered) > 5, "the queries found nothing to compare"


async def _both(client: httpx.AsyncClient, query: str) -> tuple[httpx.Response, httpx.Response]:
    return await client.get(f"/v1/obstacles?{query}"), await client.get(f"/v1/obstacles?{query}&f=geojson")
