"""The quick way of answering a circle says what SQL says, byte for byte, and leaves the same behind."""

from __future__ import annotations

import asyncio
import json
import logging
import random

import httpx
import pytest
from sqlalchemy import select

from contract.geometry import Kind, LatLon
from server import logs
from server.app import create_app
from server.errors import PROBLEM_JSON, UnavailableError
from server.geometry.geodesy import distance_m, offset_from
from server.geometry.quadkey import tiles
from server.reading.tile_reader import TileReader
from server.settings import Settings
from server.storage import tables
from server.trust.keys import Role
from tests.integration.asking import ago, by_sql, created, near, posted
from tests.integration.keys_of import bearer, client_of, keyed, opened
from tests.unit.server.making import detection, message

CIRCLE = "/v1/obstacles?lat=38.2466&lon=21.7346&radius_m=2000"
CENTRES = {
    "at the equator on the antimeridian": near(0.0, 180.0),
    "at a corner of tiles": near(0.0, 0.0),
    "in the south": near(-41.3, 174.8),
    "at the northern end": near(84.99, -179.999),
    "at the southern end": near(-84.99, 30.0),
}


async def both(client: httpx.AsyncClient, centre: LatLon, radius_m: float) -> list[str]:
    """Ids in a circle: all ways of answering say the same, and those by HTTP with the same bytes and headers."""
    query = {"lat": repr(centre.latitude_deg), "lon": repr(centre.longitude_deg), "radius_m": repr(radius_m)}
    quick = await client.get("/v1/obstacles", params=query)
    typed = await client.get("/v1/obstacles", params=query | {"f": "geojson"})
    assert quick.status_code == typed.status_code == 200
    assert quick.content == typed.content, (centre, radius_m)
    assert {**quick.headers, "x-request-id": ""} == {**typed.headers, "x-request-id": ""}
    assert quick.json()["features"] == await by_sql(client, **query), (centre, radius_m)
    return [item["id"] for item in quick.json()["features"]]


@pytest.mark.parametrize("centre", CENTRES.values(), ids=CENTRES)
async def test_memory_and_sql_say_the_same_while_obstacles_come_change_and_go(
    client: httpx.AsyncClient, centre: LatLon
) -> None:
    chance = random.Random(7)  # noqa: S311  # a test's places
    spots = [(20.0 * east + 3, 20.0 * north) for east in range(-4, 5) for north in range(-4, 5)]
    chance.shuffle(spots)
    reports = [
        message(
            *(detection(east, north, kind=chance.choice([*Kind])) for east, north in spots[first : first + 9]),
            at=ago(3),
            position=centre,
            vehicle=f"v{first}",
        )
        for first in range(0, 81, 9)
    ]
    expired = message(detection(90, 60, kind=Kind.DEBRIS), at=ago(40), position=centre, vehicle="long-ago")
    ids = await created(client, *reports)
    await posted(client, expired)
    places = await asked_in_every_size(client, centre, chance)
    assert len(places) > 70
    for identifier in chance.sample(ids, 5):
        answer = await client.post(f"/v1/obstacles/{identifier}/actions", json={"action": "repaired"})
        assert answer.status_code == 200
    # Seen again a little aside: some wander into another tile.
    again = [
        message(
            *(detection(east + 1.5, north - 1.5, 1_500) for east, north in spots[first : first + 9]),
            at=ago(2),
            position=centre,
            vehicle=f"w{first}",
        )
        for first in range(0, 81, 9)
    ]
    await posted(client, *again)
    await asked_in_every_size(client, centre, chance)


async def asked_in_every_size(client: httpx.AsyncClient, centre: LatLon, chance: random.Random) -> list[str]:
    """Everything at once, then circles that end exactly at an obstacle, and some about random places."""
    everything = await client.get(
        "/v1/obstacles",
        params={"lat": centre.latitude_deg, "lon": centre.longitude_deg, "radius_m": 2_000, "f": "geojson"},
    )
    found = everything.json()["features"]
    for item in chance.sample(found, 12):
        longitude_deg, latitude_deg = item["geometry"]["coordinates"]
        place = near(latitude_deg, longitude_deg)
        radius_m = distance_m(centre, place)
        assert item["id"] in await both(client, centre, radius_m)
        aside = offset_from(place, chance.uniform(-0.1, 0.1), chance.uniform(-0.1, 0.1))
        assert item["id"] in await both(client, aside, distance_m(aside, place))
        asked = offset_from(centre, chance.uniform(-100, 100), chance.uniform(-100, 100))
        await both(client, asked, chance.choice([0.1, 1.0, 10.0, 100.0, 1_000.0]) * chance.uniform(0.5, 2.0))
    return await both(client, centre, 2_000.0)


async def test_what_lies_exactly_on_the_edge_of_a_small_circle_belongs_to_it(client: httpx.AsyncClient) -> None:
    """Nanometres, as floats of radians are wrong by, must not decide."""
    (identifier,) = await created(client, message(detection(0, 0), at=ago(1), position=near(12.3, 179.9)))
    (found,) = (await client.get("/v1/obstacles?lat=12.3&lon=179.9&radius_m=50")).json()["features"]
    longitude_deg, latitude_deg = found["geometry"]["coordinates"]
    place = near(latitude_deg, longitude_deg)
    chance = random.Random(3)  # noqa: S311  # a test's places
    for _ in range(200):
        asked = offset_from(place, chance.uniform(-0.1, 0.1), chance.uniform(-0.1, 0.1))
        assert await both(client, asked, distance_m(asked, place)) == [str(identifier)]


ODD = ["1.0e+1", "+1", "1_0", "nan", "inf", "%31", "%2B1", "", "1e1", "0x1", "٣", "1" * 400, "-0", "1 ", ".5", "5.0"]


async def test_a_number_is_taken_or_refused_by_both_ways_alike(client: httpx.AsyncClient) -> None:
    statuses = set()
    for name in ("lat", "lon", "radius_m", "limit"):
        for value in ODD:
            others = "".join(f"&{other}=1" for other in ("lat", "lon") if other != name)
            quick = await client.get(f"/v1/obstacles?{name}={value}{others}")
            typed = await client.get(f"/v1/obstacles?{name}={value}{others}&f=geojson")
            assert quick.status_code == typed.status_code, (name, value)
            statuses.add(quick.status_code)
    assert statuses == {200, 422}


async def test_a_body_that_nobody_asked_for_is_limited_like_any_other(client: httpx.AsyncClient) -> None:
    too_large = await client.request("GET", CIRCLE, content=b"x" * (2 << 20))
    assert (too_large.status_code, too_large.json()["type"]) == (413, "urn:headsup:problem:body-too-large")
    packed = await client.request("GET", CIRCLE, content=b"x", headers={"Content-Encoding": "gzip"})
    assert packed.status_code == 415
    assert (await client.request("GET", CIRCLE, content=b"x")).status_code == 200


async def test_a_request_that_is_handed_on_keeps_its_name_and_its_key(
    guarded: Settings, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What is logged on the quick way is found by the `X-Request-Id` of the answer, and every line names the key."""
    level = logging.getLogger("server").level
    async with opened(guarded.model_copy(update={"log_requests": "all"})) as app, client_of(app) as client:
        (key,) = await keyed(app, Role.READER)
        logs.configure("info", "json")
        capsys.readouterr()

        async def broken(*_: object) -> None:
            raise RuntimeError

        monkeypatch.setattr(app.state.parts.nearby, "within", broken)
        answer = await client.get(CIRCLE, headers=bearer(key))
    logging.getLogger("server").setLevel(level)
    lines = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert answer.status_code == 200
    # The quick way fails, then memory behind the typed route; SQL answers.
    assert [line["message"] for line in lines] == ["unexpected error", "unexpected error", "request"]
    assert {line["request_id"] for line in lines} == {answer.headers["x-request-id"]}
    assert len({line.get("key_id") for line in lines} - {None}) == 1
    assert all("key_id" in line for line in lines)


async def test_the_time_of_a_request_that_is_handed_on_counts_from_its_beginning(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with opened(settings) as app, client_of(app) as client:

        async def broken(*_: object) -> None:
            await asyncio.sleep(0.2)
            raise RuntimeError

        monkeypatch.setattr(app.state.parts.nearby, "within", broken)
        assert (await client.get(CIRCLE)).status_code == 200
        text = (await client.get("/metrics")).text
    (total,) = [line for line in text.splitlines() if line.startswith("headsup_request_seconds_sum{")]
    assert float(total.split()[-1]) >= 0.2


async def test_who_has_waited_for_the_database_in_vain_is_told_so_and_does_not_wait_again(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with opened(settings) as app, client_of(app) as client:
        waits = 0

        async def lost(*_: object) -> None:
            nonlocal waits
            waits += 1
            raise UnavailableError("the database did not answer")

        monkeypatch.setattr(app.state.parts.nearby, "within", lost)
        quick = await client.get(CIRCLE)
    assert (quick.status_code, quick.headers["retry-after"], waits) == (503, "1", 1)
    assert (quick.headers["content-type"], quick.json()["type"]) == (PROBLEM_JSON, "urn:headsup:problem:unavailable")
    assert quick.headers["x-request-id"]


async def test_a_request_before_the_parts_are_there_is_a_problem(settings: Settings) -> None:
    transport = httpx.ASGITransport(create_app(settings), raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
        answer = await client.get(CIRCLE)
    assert (answer.status_code, answer.json()["type"]) == (500, "urn:headsup:problem:internal")
    assert "x-request-id" in answer.headers


async def test_versions_of_tens_of_thousands_of_tiles_are_one_answer(settings: Settings) -> None:
    """So many does a crowd ask for at once near 85 degrees, where a circle of 2 km has 400."""
    async with opened(settings) as app, client_of(app) as client:
        await created(client, message(detection(), at=ago(1)))
        database = app.state.parts.database
        async with database.read() as connection:
            stored = {row.tile: row.version for row in await connection.execute(select(tables.tile))}
        far = {n for column in range(120) for n in tiles(near(84.9, 3.0 * column - 179), 2_000.0)}
        assert len(far) > 40_000
        assert await TileReader(database, app.state.parts.life).versions(sorted(far | set(stored))) == stored
        assert stored


async def test_who_goes_away_during_a_check_takes_nobody_with_them(settings: Settings) -> None:
    async with opened(settings) as app, client_of(app) as client:
        (identifier,) = await created(client, message(detection(), at=ago(1)))
        waiting = [asyncio.create_task(client.get(CIRCLE)) for _ in range(12)]
        await asyncio.sleep(0)
        for task in waiting[::3]:
            task.cancel()
        answers = await asyncio.gather(*waiting, return_exceptions=True)
        kept = [item for item in answers if isinstance(item, httpx.Response)]
        assert len(kept) == 8
        assert {item.json()["features"][0]["id"] for item in kept} == {str(identifier)}
