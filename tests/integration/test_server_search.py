"""Searching readers on both databases: areas, filters, pages, and answers that a client may keep."""

from __future__ import annotations

import gzip
import math
import random
from uuid import UUID

import httpx
import pytest

from contract.geometry import Kind, LatLon
from contract.observation import ObservationReport
from server.app import create_app
from server.reading.around import geodesic
from server.settings import Settings
from tests.integration.asking import AROUND_PATRAS, JSON, ago, created, near, obstacles, pages, posted
from tests.unit.server.making import PATRAS, detection, message

FIJI = near(-16.8, 179.9999)


def scattered(number: int, seed: int = 1) -> list[ObservationReport]:
    """Reports of obstacles at least 10 m apart within 114 m of four places around Patras."""
    rng = random.Random(seed)  # noqa: S311  # a test's places
    cells = rng.sample([(east, north) for east in range(-8, 9) for north in range(-8, 9)], number)
    places = [near(PATRAS.latitude_deg + up, PATRAS.longitude_deg + right) for up, right in CORNERS]
    kinds = [*Kind]
    found = []
    for index, place in enumerate(places):
        seen = [detection(10 * e, 10 * n, kind=kinds[(e + n) % 3]) for e, n in cells[index :: len(places)]]
        found.append(message(*seen, at=ago(1), position=place, vehicle=f"scout{index}"))
    return found


CORNERS = [(0.0, 0.0), (0.004, 0.0), (0.0, -0.006), (-0.008, 0.005)]


async def test_pages_of_a_circle_are_the_whole_answer_nearest_first(client: httpx.AsyncClient) -> None:
    ids = await created(client, *scattered(40))
    whole = await obstacles(client, **AROUND_PATRAS, f="geojson")
    assert {item.id for item in whole} == set(ids)
    distances_m = [geodesic(PATRAS, item.position.latitude_deg, item.position.longitude_deg)[0] for item in whole]
    assert distances_m == sorted(distances_m)
    for limit in (1, 7, 40):
        found = await pages(client, "/v1/obstacles", **AROUND_PATRAS, limit=limit, f="geojson")
        assert [len(page["features"]) for page in found[:-1]] == [limit] * (len(found) - 1)
        assert [UUID(item["id"]) for page in found for item in page["features"]] == [item.id for item in whole]


async def test_pages_of_a_box_are_the_whole_answer_in_a_fixed_order(client: httpx.AsyncClient) -> None:
    ids = await created(client, *scattered(40))
    bbox = "21.7,38.2,21.8,38.3"
    whole = [item.id for item in await obstacles(client, bbox=bbox)]
    assert set(whole) == set(ids)
    found = await pages(client, "/v1/obstacles", bbox=bbox, limit=11)
    assert [UUID(item["id"]) for page in found for item in page["features"]] == whole
    narrow = await obstacles(client, bbox="21.73,38.245,21.736,38.2475")
    assert {item.id for item in narrow} == {
        item.id
        for item in await obstacles(client, bbox=bbox)
        if 21.73 <= item.position.longitude_deg <= 21.736 and 38.245 <= item.position.latitude_deg <= 38.2475
    }
    assert 0 < len(narrow) < 40


@pytest.mark.parametrize("area", [AROUND_PATRAS, {"bbox": "21.7,38.2,21.8,38.3"}], ids=["circle", "box"])
async def test_paging_while_others_write_repeats_and_misses_nothing_that_stays(
    client: httpx.AsyncClient, area: dict[str, object]
) -> None:
    ids = await created(client, *scattered(24))
    seen: list[UUID] = []
    answer = await client.get("/v1/obstacles", params=area | {"limit": 5})
    number = 0
    while True:
        seen += [UUID(item["id"]) for item in answer.json()["features"]]
        if "next" not in answer.links:
            break
        number += 1
        # Beyond the reach of any match with what is there, at another distance each time.
        place = near(PATRAS.latitude_deg + 0.002 * number, PATRAS.longitude_deg + 0.012)
        await posted(client, message(detection(), at=ago(0.5), position=place, vehicle=f"late{number}"))
        answer = await client.get(answer.links["next"]["url"])
    assert len(seen) == len(set(seen))
    assert set(ids) <= set(seen)


async def test_a_box_crosses_the_antimeridian(client: httpx.AsyncClient) -> None:
    await posted(client, message(detection(-30, 0), detection(30, 0), at=ago(1), position=FIJI))
    both = await obstacles(client, bbox="179,-17,-179,-16")
    assert sorted(item.position.longitude_deg > 0 for item in both) == [False, True]
    assert len(await obstacles(client, bbox="179,-17,180,-16")) == 1
    assert len(await obstacles(client, bbox="-180,-17,-179,-16")) == 1
    assert await obstacles(client, bbox="-179,-17,179,-16") == ()
    assert len(await obstacles(client, bbox="-180,-90,180,90")) == 2


async def test_boxes_and_circles_reach_to_the_poles(client: httpx.AsyncClient) -> None:
    for vehicle, latitude_deg in (("north", 84.9), ("south", -84.9)):
        there = near(latitude_deg, 100.0)
        await created(client, message(detection(0, 0), at=ago(1), position=there, vehicle=vehicle))
    assert len(await obstacles(client, bbox="-180,84,180,90")) == 1
    assert len(await obstacles(client, bbox="-180,-90,180,-84")) == 1
    assert len(await obstacles(client, bbox="90,-90,110,90")) == 2
    assert await obstacles(client, lat=90, lon=0, radius_m=50_000) == ()
    assert len(await obstacles(client, lat=85, lon=100, radius_m=50_000)) == 1


async def test_filters_narrow_the_answer(client: httpx.AsyncClient) -> None:
    hole, bump, debris = await created(
        client,
        message(detection(0, 0), vehicle="a", at=ago(30)),
        message(detection(40, 0, kind=Kind.BUMP), vehicle="a", at=ago(29)),
        message(detection(80, 0, kind=Kind.DEBRIS), vehicle="a", at=ago(2)),
    )
    await posted(client, message(detection(40, 0, kind=Kind.BUMP), vehicle="b", at=ago(1)))
    kinds = await obstacles(client, **AROUND_PATRAS, kind="pothole,bump")
    assert {item.id for item in kinds} == {hole, bump}
    repeated = await obstacles(client, **AROUND_PATRAS, kind=["bump", "debris"])
    assert {item.id for item in repeated} == {bump, debris}
    assert [item.id for item in await obstacles(client, **AROUND_PATRAS, state="confirmed")] == [bump]
    assert {item.id for item in await obstacles(client, **AROUND_PATRAS, state="candidate")} == {hole, debris}
    recent = await obstacles(client, **AROUND_PATRAS, seen_since=ago(3).isoformat())
    assert {item.id for item in recent} == {bump, debris}


async def test_the_least_confidence_is_that_of_now(client: httpx.AsyncClient) -> None:
    await created(
        client,
        message(detection(0, 0, kind=Kind.DEBRIS), vehicle="a", at=ago(9)),
        message(detection(40, 0), vehicle="a", at=ago(9)),
    )
    served = {item.properties.kind: item.properties for item in await obstacles(client, **AROUND_PATRAS)}
    debris = served[Kind.DEBRIS]
    now = debris.confidence * 0.5 ** (9 * 3600 / debris.half_life_s)
    below = await obstacles(client, **AROUND_PATRAS, min_confidence=now - 0.005)
    above = await obstacles(client, **AROUND_PATRAS, min_confidence=now + 0.005)
    assert [len(below), len(above)] == [2, 1]
    assert above[0].properties.kind is Kind.POTHOLE


async def test_what_has_expired_is_not_live(client: httpx.AsyncClient) -> None:
    await created(client, message(detection(kind=Kind.DEBRIS), vehicle="a", at=ago(40)))
    for query in ({}, {"state": "candidate"}, {"kind": "debris"}, {"min_confidence": 0.01}):
        assert await obstacles(client, **AROUND_PATRAS, **query) == ()


async def test_only_what_lies_ahead(client: httpx.AsyncClient) -> None:
    await created(client, *scattered(40))
    everything = await obstacles(client, **AROUND_PATRAS, f="geojson")
    ahead_in_all = 0
    for heading_deg, corridor_m in ((0, None), (90, 60.0), (200, 90.0), (360, 90.0)):
        query = (
            AROUND_PATRAS | {"heading_deg": heading_deg} | ({} if corridor_m is None else {"corridor_m": corridor_m})
        )
        expected = [item.id for item in everything if is_ahead(item.position, heading_deg, corridor_m)]
        assert len(expected) < 40
        ahead_in_all += len(expected)
        assert [item.id for item in await obstacles(client, **query)] == expected
        paged = await pages(client, "/v1/obstacles", **query, limit=3)
        assert [UUID(item["id"]) for page in paged for item in page["features"]] == expected
    assert ahead_in_all > 20


def is_ahead(position: LatLon, heading_deg: float, corridor_m: float | None) -> bool:
    distance_m, azimuth_rad = geodesic(PATRAS, position.latitude_deg, position.longitude_deg)
    turn_rad = azimuth_rad - math.radians(heading_deg)
    across_m = abs(distance_m * math.sin(turn_rad))
    return math.cos(turn_rad) >= 0 and (corridor_m is None or across_m <= corridor_m / 2)


REFUSED = {
    "lat=0&lon=0&foo=1": "foo",
    "lat=0&lon=0&raduis_m=5": "raduis_m",
    "lat=0&lon=0&kind=puddle": "kind",
    "lat=0": "one area",
    "bbox=0,0,1": "bbox",
    "bbox=0,1,1,0": "south",
    "bbox=0,0,1,1&lat=0&lon=0": "one area",
    "lat=0&lon=0&cursor=zzz": "cursor",
    "lat=0&lon=0&f=xml": "f",
}


async def test_a_refusal_names_what_is_wrong(client: httpx.AsyncClient) -> None:
    for query, named in REFUSED.items():
        answer = await client.get(f"/v1/obstacles?{query}")
        assert (answer.status_code, answer.headers["content-type"]) == (422, "application/problem+json")
        (complaint,) = answer.json()["errors"]
        assert named in complaint["where"] + complaint["what"]


async def test_both_ways_of_answering_a_circle_have_the_same_bytes(client: httpx.AsyncClient) -> None:
    await created(client, *scattered(12))
    plain = await client.get("/v1/obstacles", params=AROUND_PATRAS)
    typed = await client.get("/v1/obstacles", params=AROUND_PATRAS | {"f": "geojson"})
    assert plain.content == typed.content
    assert plain.headers["etag"] == typed.headers["etag"]
    assert plain.content.startswith(b'{"type":"FeatureCollection","features":[{"type":"Feature"')
    assert "links" not in plain.json()


async def test_what_is_current_is_not_sent_again(client: httpx.AsyncClient) -> None:
    (identifier,) = await created(client, message(detection(), vehicle="a", at=ago(2)))
    queries = [
        AROUND_PATRAS,
        AROUND_PATRAS | {"heading_deg": 60},
        {"bbox": "21,38,22,39"},
        AROUND_PATRAS | {"f": "denm"},
    ]
    tags = []
    for query in queries:
        first = await client.get("/v1/obstacles", params=query)
        tags.append(first.headers["etag"])
        assert first.headers["cache-control"] == "no-cache"
        assert "accept-encoding" in first.headers["vary"].lower()
        again = await client.get("/v1/obstacles", params=query, headers={"If-None-Match": f'"x", {tags[-1]}'})
        assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", tags[-1])
    one = await client.get(f"/v1/obstacles/{identifier}")
    assert (await client.get(one.url, headers={"If-None-Match": one.headers["etag"]})).status_code == 304
    await posted(client, message(detection(), vehicle="b", at=ago(1)))
    for query, tag in zip(queries, tags, strict=True):
        changed = await client.get("/v1/obstacles", params=query, headers={"If-None-Match": tag})
        assert changed.status_code == 200
        assert changed.headers["etag"] != tag
    assert (await client.get(one.url, headers={"If-None-Match": one.headers["etag"]})).status_code == 200


async def test_large_answers_are_compressed_for_those_who_take_it(client: httpx.AsyncClient) -> None:
    await created(client, *scattered(12))
    query = {"bbox": "21,38,22,39"}
    async with client.stream("GET", "/v1/obstacles", params=query, headers={"Accept-Encoding": "gzip"}) as answer:
        raw = b"".join([part async for part in answer.aiter_raw()])
    plain = await client.get("/v1/obstacles", params=query, headers={"Accept-Encoding": "identity"})
    assert answer.headers["content-encoding"] == "gzip"
    assert "content-encoding" not in plain.headers
    assert gzip.decompress(raw) == plain.content
    assert len(raw) < len(plain.content) / 3


FORMATS = {
    "geojson": "application/geo+json",
    "denm": "application/vnd.headsup.denm+json",
    "datex": "application/vnd.headsup.datex+xml",
    "itis": "application/vnd.headsup.itis+json",
    "waze": "application/vnd.headsup.cifs+json",
    "fiware": "application/ld+json",
}


async def test_every_format_by_name_and_by_header(client: httpx.AsyncClient) -> None:
    (identifier, _) = await created(client, message(detection(0, 0), detection(50, 0), vehicle="a", at=ago(2)))
    for name, media_type in FORMATS.items():
        for path, query in (("/v1/obstacles", AROUND_PATRAS | {"limit": 5}), (f"/v1/obstacles/{identifier}", {})):
            named = await client.get(path, params=query | {"f": name})
            accepted = await client.get(path, params=query, headers={"Accept": media_type})
            assert named.headers["content-type"].partition(";")[0] == media_type
            assert accepted.headers["content-type"].partition(";")[0] == media_type
            assert accepted.headers["etag"] == named.headers["etag"]


async def test_pages_keep_their_format(client: httpx.AsyncClient) -> None:
    await created(client, message(detection(0, 0), detection(50, 0), vehicle="a", at=ago(2)))
    first = await client.get("/v1/obstacles", params=AROUND_PATRAS | {"limit": 1, "f": "denm"})
    assert first.links["next"]["type"] == FORMATS["denm"]
    second = await client.get(first.links["next"]["url"])
    assert second.headers["content-type"] == FORMATS["denm"]
    messages = [answer.json()["messages"] for answer in (first, second)]
    assert [len(found) for found in messages] == [1, 1]
    assert messages[0] != messages[1]
    assert "next" not in second.links


async def test_a_format_that_there_is_not_is_refused(client: httpx.AsyncClient) -> None:
    answer = await client.get("/v1/obstacles", params=AROUND_PATRAS, headers={"Accept": "text/html"})
    assert (answer.status_code, answer.headers["content-type"]) == (406, "application/problem+json")
    assert "application/geo+json" in answer.json()["detail"]


async def test_a_body_that_is_no_json_is_refused(client: httpx.AsyncClient) -> None:
    for headers in ({"Content-Type": "text/plain"}, {"Content-Type": "application/xml"}, {}):
        answer = await client.post("/v1/observations", content=b"{}", headers=headers)
        assert (answer.status_code, answer.json()["type"]) == (415, "urn:headsup:problem:unsupported-media-type")
    assert (await client.post("/v1/observations", content=b"{}", headers=JSON)).status_code == 422


@pytest.mark.parametrize("accepted", ["identity", "gzip"])
async def test_what_is_answered_from_memory_and_by_sql_are_the_same_bytes_and_headers(
    client: httpx.AsyncClient, accepted: str
) -> None:
    await created(client, *scattered(40))
    for circle in (AROUND_PATRAS, AROUND_PATRAS | {"radius_m": 300}, {"lat": 1.0, "lon": 1.0}):
        answers = [
            await client.get("/v1/obstacles", params=circle | form, headers={"Accept-Encoding": accepted})
            for form in ({}, {"f": "geojson"})
        ]
        said = [{**answer.headers, "x-request-id": ""} for answer in answers]
        assert (said[0], answers[0].content) == (said[1], answers[1].content)
        held = {"If-None-Match": answers[0].headers["etag"]}
        again = [
            await client.get("/v1/obstacles", params=circle | form, headers=held) for form in ({}, {"f": "geojson"})
        ]
        assert [answer.status_code for answer in again] == [304, 304]
        assert [{**answer.headers, "x-request-id": ""} for answer in again[1:]] == [
            {**again[0].headers, "x-request-id": ""}
        ]


async def test_a_fault_of_the_way_from_memory_is_answered_by_sql(settings: Settings) -> None:
    app = create_app(settings)
    async with app.router.lifespan_context(app):
        transport = httpx.ASGITransport(app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            (identifier,) = await created(client, scattered(1)[0])
            app.state.parts.nearby._cache = None
            assert [item.id for item in await obstacles(client, **AROUND_PATRAS)] == [identifier]
