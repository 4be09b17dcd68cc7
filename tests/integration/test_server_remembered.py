"""Searches of small areas say from memory what SQL says."""

from __future__ import annotations

import random
from datetime import datetime
from typing import Any

import httpx
import pytest

from contract.geometry import Kind, LatLon
from server.geometry.geodesy import offset_from
from tests.integration.asking import ago, by_sql, created, near, posted
from tests.unit.server.making import absent, detection, message

CENTRES = {
    "at the equator on the antimeridian": near(0.0, 180.0),
    "in the north": near(84.9, 30.0),
    "in the south": near(-41.3, 174.8),
}


async def street(client: httpx.AsyncClient, centre: LatLon, chance: random.Random) -> None:
    """Some 60 obstacles of all kinds, ages and certainties; a third seen by two, some gone, some long expired."""
    spots = [(20.0 * east, 20.0 * north) for east in range(-4, 4) for north in range(-4, 4)]
    chance.shuffle(spots)
    for number, first in enumerate(range(0, 64, 8)):
        hours = chance.choice([1, 5, 30, 60])
        seen = [
            detection(east, north, kind=chance.choice([*Kind]), confidence=chance.uniform(0.4, 1.0))
            for east, north in spots[first : first + 8]
        ]
        ids = await created(client, message(*seen, at=ago(hours), position=centre, vehicle=f"v{number}"))
        if number % 3 == 0:
            await posted(client, message(*seen[:4], at=ago(hours - 0.5), position=centre, vehicle=f"w{number}"))
        if number % 4 == 1:
            gone = (absent(ids[0]),)
            await posted(client, message(inspections=gone, at=ago(hours - 0.5), position=centre, vehicle=f"v{number}"))


def circle(centre: LatLon, chance: random.Random) -> dict[str, Any]:
    return {
        "lat": centre.latitude_deg + chance.gauss(0, 2e-4),
        "lon": centre.longitude_deg,
        "radius_m": chance.choice([30.0, 90.0, 300.0, 2_000.0]),
    }


def box(centre: LatLon, chance: random.Random) -> dict[str, Any]:
    """Of any form, from a few metres to some kilometres, with the centre somewhere in it."""
    sizes_m = [chance.choice([10.0, 60.0, 150.0, 1_500.0]) * chance.uniform(0.5, 1.0) for _ in range(4)]
    west, east = (offset_from(centre, east_m, 0.0).longitude_deg for east_m in (-sizes_m[0], sizes_m[1]))
    south, north = (offset_from(centre, 0.0, north_m).latitude_deg for north_m in (-sizes_m[2], sizes_m[3]))
    return {"bbox": ",".join(f"{edge:.7f}" for edge in (west, south, east, north))}


def asked(centre: LatLon, chance: random.Random) -> dict[str, Any]:
    """A query that memory can answer, with each filter now and then."""
    query = box(centre, chance) if chance.random() < 0.4 else circle(centre, chance)
    if chance.random() < 0.4:
        query["kind"] = chance.sample([kind.value for kind in Kind], chance.choice([1, 2]))
    if chance.random() < 0.4:
        query["state"] = chance.choice([["candidate"], ["confirmed"], ["candidate", "confirmed"]])
    if chance.random() < 0.4:
        query["min_confidence"] = chance.choice([0.01, 0.2, 0.35, 0.5, 0.6])
    if chance.random() < 0.4:
        query["seen_since"] = ago(chance.choice([3, 10, 100])).isoformat()
    if "lat" in query and chance.random() < 0.5:
        query["heading_deg"] = chance.choice([0.0, 90.0, 360.0, chance.uniform(0, 360)])
        if chance.random() < 0.7:
            query["corridor_m"] = chance.choice([10.0, 50.0, 120.0])
    return query


@pytest.mark.parametrize("centre", CENTRES.values(), ids=CENTRES)
async def test_memory_and_sql_find_the_same_with_any_filter(client: httpx.AsyncClient, centre: LatLon) -> None:
    chance = random.Random(11)  # noqa: S311  # a test's street
    await street(client, centre, chance)
    sizes = []
    for _ in range(50):
        query = asked(centre, chance)
        answer = await client.get("/v1/obstacles", params=query)
        assert answer.status_code == 200, (query, answer.text)
        assert answer.json()["features"] == await by_sql(client, **query), query
        sizes.append(len(answer.json()["features"]))
    assert len({size for size in sizes if size > 0}) > 10, sizes


async def test_a_strip_around_the_whole_earth_is_no_small_box(client: httpx.AsyncClient) -> None:
    (hole,) = await created(client, message(detection(), at=ago(1), position=CENTRES["in the south"]))
    for west, east in ((-180, 180), (0, -1e-7), (174.7, 174.9)):
        answer = await client.get("/v1/obstacles", params={"bbox": f"{west:.7f},-41.31,{east:.7f},-41.29"})
        assert [item["id"] for item in answer.json()["features"]] == [str(hole)], (west, east)


async def test_an_answer_of_several_pages_is_that_of_one(client: httpx.AsyncClient) -> None:
    chance = random.Random(12)  # noqa: S311  # a test's street
    centre = CENTRES["in the south"]
    await street(client, centre, chance)
    query = {"lat": centre.latitude_deg, "lon": centre.longitude_deg, "radius_m": 500, "min_confidence": 0.1}
    whole = (await client.get("/v1/obstacles", params=query)).json()
    first = (await client.get("/v1/obstacles", params=query | {"limit": len(whole["features"]) - 1})).json()
    (following,) = [link["href"] for link in first["links"] if link["rel"] == "next"]
    rest = (await client.get(following)).json()
    assert first["features"] + rest["features"] == whole["features"]
    assert "links" not in whole


async def test_a_filter_sees_what_an_answered_report_has_changed(client: httpx.AsyncClient) -> None:
    centre = CENTRES["in the south"]
    query = {"lat": centre.latitude_deg, "lon": centre.longitude_deg, "radius_m": 100, "state": "confirmed"}
    for number in range(2):
        assert (await client.get("/v1/obstacles", params=query)).json()["features"] == []
        await posted(client, message(detection(), at=ago(3 - number), position=centre, vehicle=f"v{number}"))
    (seen,) = (await client.get("/v1/obstacles", params=query)).json()["features"]
    assert datetime.fromisoformat(seen["properties"]["last_seen"]) > ago(2.5)
