"""The HTTP interface on both databases, through the real application."""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime, timedelta
from uuid import uuid4

import httpx
import pytest

from contract.geometry import LatLon
from contract.observation import (
    MAX_BODY_BYTES,
    ObservationBatch,
    ObservationBatchResult,
    ObservationReport,
    ReportResult,
    ReportStatus,
)
from contract.obstacle import ObstacleCollection, ObstacleFeature
from server.geometry.geodesy import distance_m
from server.geometry.quadkey import tiles
from server.settings import Settings
from tests.integration.conftest import OPERATOR_KEY, serving
from tests.unit.server.making import HOUR, PATRAS, absent, detection, message

BEARER = {"Authorization": f"Bearer {OPERATOR_KEY}"}


def ago(hours: float) -> datetime:
    return datetime.now(UTC) - hours * HOUR


async def posted(
    client: httpx.AsyncClient, *reports: ObservationReport, sent_at: datetime | None = None
) -> list[ReportResult]:
    batch = ObservationBatch(sent_at=sent_at or datetime.now(UTC), reports=reports)
    answer = await client.post("/v1/observations", content=batch.model_dump_json(), headers=JSON)
    assert answer.status_code == 200, answer.text
    return list(ObservationBatchResult.model_validate_json(answer.content).results)


JSON = {"Content-Type": "application/json"}


async def near(
    client: httpx.AsyncClient, centre: LatLon = PATRAS, radius_m: float = 500.0
) -> tuple[ObstacleFeature, ...]:
    where = {"lat": centre.latitude_deg, "lon": centre.longitude_deg, "radius_m": radius_m}
    answer = await client.get("/v1/obstacles", params=where)
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "application/geo+json"
    return ObstacleCollection.model_validate_json(answer.content).features


async def test_the_life_of_an_obstacle(client: httpx.AsyncClient) -> None:
    (created,) = await posted(client, message(detection(), vehicle="ego1", at=ago(9)))
    (kept,) = await posted(client, message(detection(), vehicle="ego2", at=ago(8)))
    (updated,) = await posted(client, message(detection(length_mm=1250), vehicle="ego3", at=ago(7)))
    identifier = created.detections[0].obstacle_id
    assert identifier is not None
    answers = [result.detections[0] for result in (created, kept, updated)]
    assert [a.decision for a in answers] == ["created", "kept", "updated"]
    assert [(a.version, a.revision, a.state) for a in answers] == [
        (1, 1, "candidate"),
        (1, 2, "confirmed"),
        (2, 3, "confirmed"),
    ]
    (feature,) = await near(client)
    assert (feature.id, feature.properties.box.length_mm) == (identifier, 1250)
    missed = await posted(
        client,
        message(vehicle="ego4", at=ago(2), inspections=(absent(identifier),)),
        message(vehicle="ego5", at=ago(1), inspections=(absent(identifier),)),
    )
    assert [result.inspections[0].removed for result in missed] == [False, True]
    assert await near(client) == ()
    removed = ObstacleFeature.model_validate_json((await client.get(f"/v1/obstacles/{identifier}")).content)
    assert (removed.properties.state, removed.properties.witnesses) == ("removed", 3)


async def test_a_repeated_report_is_answered_as_before_and_counts_once(client: httpx.AsyncClient) -> None:
    report = message(detection(), at=ago(1))
    (first,) = await posted(client, report)
    (second,) = await posted(client, report, sent_at=datetime.now(UTC) - timedelta(hours=5))
    assert second == first.model_copy(update={"status": ReportStatus.DUPLICATE})
    assert [feature.properties.sightings for feature in await near(client)] == [1]


async def test_another_body_under_the_same_report_id_is_a_conflict(client: httpx.AsyncClient) -> None:
    report = message(detection(), at=ago(1))
    changed = report.model_copy(update={"detections": (detection(30, 30),)})
    results = await posted(client, report, changed)
    assert [(result.status, result.reason) for result in results] == [("accepted", None), ("rejected", "conflict")]
    assert len(await near(client)) == 1


async def test_reports_are_answered_in_order_with_a_result_for_each_detection(client: httpx.AsyncClient) -> None:
    reports = [message(detection(20 * n, 0), detection(20 * n, 300), at=ago(1), number=n) for n in range(4)]
    results = await posted(client, *reports)
    assert [result.report_id for result in results] == [report.report_id for report in reports]
    assert [[d.decision for d in result.detections] for result in results] == [["created", "rejected"]] * 4
    assert {result.detections[1].reason for result in results} == {"out-of-reach"}


@pytest.mark.parametrize(
    ("observed", "sent", "reason"),
    [
        (timedelta(hours=-1), timedelta(minutes=11), "clock-skew"),
        (timedelta(hours=-1), timedelta(minutes=-11), "clock-skew"),
        (timedelta(minutes=1), timedelta(), "in-the-future"),
        (timedelta(days=-7, minutes=-1), timedelta(), "too-old"),
    ],
)
async def test_impossible_times_are_rejected(
    client: httpx.AsyncClient, observed: timedelta, sent: timedelta, reason: str
) -> None:
    now = datetime.now(UTC)
    (result,) = await posted(client, message(detection(), at=now + observed), sent_at=now + sent)
    assert (result.status, result.reason) == ("rejected", reason)


@pytest.mark.parametrize("year", [1, 9999])
async def test_the_ends_of_the_calendar_are_rejected(client: httpx.AsyncClient, year: int) -> None:
    last = datetime(year, 12, 31, 23, 59, 59, tzinfo=UTC)
    results = await posted(client, message(detection(), at=last), sent_at=datetime.now(UTC) - timedelta(minutes=9))
    assert [result.status for result in results] == ["rejected"]


async def test_a_clock_that_is_minutes_wrong_is_corrected(client: httpx.AsyncClient) -> None:
    now = datetime.now(UTC)
    fast = timedelta(minutes=5)
    (result,) = await posted(client, message(detection(), at=now + fast), sent_at=now + fast)
    assert result.status == "accepted"
    (feature,) = await near(client)
    assert abs(feature.properties.last_seen - now) < timedelta(seconds=60)


async def test_hours_old_reports_of_an_offline_vehicle_are_accepted(client: httpx.AsyncClient) -> None:
    (result,) = await posted(client, message(detection(), at=ago(6 * 24)))
    assert result.status == "accepted"


async def test_answers_are_sorted_by_geodesic_distance_and_limited(client: httpx.AsyncClient) -> None:
    await posted(client, message(*(detection(east, 0) for east in (90, -20, 50, -70)), at=ago(1)))
    found = await near(client, radius_m=80)
    distances_m = [distance_m(feature.position, PATRAS) for feature in found]
    assert distances_m == pytest.approx([20, 50, 70], abs=0.01)
    where = {"lat": PATRAS.latitude_deg, "lon": PATRAS.longitude_deg, "radius_m": 80, "limit": 2}
    limited = ObstacleCollection.model_validate_json((await client.get("/v1/obstacles", params=where)).content)
    assert limited.features == found[:2]


async def test_the_antimeridian_is_no_border(client: httpx.AsyncClient) -> None:
    fiji = LatLon(latitude_deg=-16.8, longitude_deg=179.9999)
    await posted(client, message(detection(-30, 0), detection(30, 0), at=ago(1), position=fiji))
    found = await near(client, fiji, radius_m=100)
    assert sorted(feature.position.longitude_deg > 0 for feature in found) == [False, True]
    kept = await posted(client, message(detection(30, 0), at=ago(0.5), vehicle="ego2", position=fiji))
    assert kept[0].detections[0].decision == "kept"


@pytest.mark.parametrize("latitude_deg", [90.0, -90.0, 89.99])
async def test_a_report_from_a_pole_is_rejected_and_holds_nobody_up(
    client: httpx.AsyncClient, latitude_deg: float
) -> None:
    honest = message(detection(), at=ago(3))
    pole = LatLon(latitude_deg=latitude_deg, longitude_deg=0.0)
    at_pole = message(detection(), at=ago(2)).model_copy(
        update={"report_id": uuid4(), "origin": honest.origin.model_copy(update={"position": pole})}
    )
    results = await posted(client, honest, at_pole, message(detection(), vehicle="ego2", at=ago(1)))
    assert [(r.status, r.reason) for r in results] == [
        ("accepted", None),
        ("rejected", "beyond-the-map"),
        ("accepted", None),
    ]


async def test_twenty_writers_create_an_obstacle_at_a_tile_corner_once(client: httpx.AsyncClient) -> None:
    corner = LatLon(latitude_deg=0.0, longitude_deg=0.0)
    assert len(tiles(corner, 100)) == 4
    reports = [
        message(detection(0.1 * (n % 5), 0.1 * (n % 3)), vehicle=f"ego{n}", at=ago(1), position=corner)
        for n in range(20)
    ]
    results = await asyncio.gather(*(posted(client, report) for report in reports))
    decisions = sorted(result[0].detections[0].decision.value for result in results)
    assert decisions == ["created"] + ["kept"] * 19
    (feature,) = await near(client, corner)
    assert (feature.properties.sightings, feature.properties.witnesses) == (20, 20)


async def test_two_servers_on_one_database_create_an_obstacle_once(settings: Settings) -> None:
    corner = LatLon(latitude_deg=0.0, longitude_deg=0.0)
    async with serving(settings) as one, serving(settings) as other:
        reports = [message(detection(0, 0), vehicle=f"ego{n}", at=ago(1), position=corner) for n in range(20)]
        pairs = zip([one, other] * 10, reports, strict=True)
        results = await asyncio.gather(*(posted(client, report) for client, report in pairs))
        (feature,) = await near(other, corner)
    assert sorted(result[0].detections[0].decision.value for result in results) == ["created"] + ["kept"] * 19
    assert feature.properties.sightings == 20


async def test_the_same_report_sent_at_once_twice_counts_once(client: httpx.AsyncClient) -> None:
    report = message(detection(), at=ago(1))
    results = await asyncio.gather(*(posted(client, report) for _ in range(5)))
    assert sorted(result[0].status.value for result in results) == ["accepted"] + ["duplicate"] * 4
    assert [feature.properties.sightings for feature in await near(client)] == [1]


async def test_an_unknown_obstacle_is_a_problem(client: httpx.AsyncClient) -> None:
    answer = await client.get(f"/v1/obstacles/{uuid4()}")
    assert (answer.status_code, answer.headers["content-type"]) == (404, "application/problem+json")
    assert answer.json()["type"] == "urn:headsup:problem:obstacle-not-found"


@pytest.mark.parametrize(
    "query",
    ["lat=91&lon=0", "lat=nan&lon=0", "lat=0&lon=inf", "lat=0", "lat=0&lon=0&radius_m=50001", "lat=0&lon=0&limit=0"],
)
async def test_an_impossible_query_is_a_problem(client: httpx.AsyncClient, query: str) -> None:
    answer = await client.get(f"/v1/obstacles?{query}")
    assert (answer.status_code, answer.headers["content-type"]) == (422, "application/problem+json")


HOSTILE = {
    "nothing": b"",
    "no JSON": b"{",
    "not text": b"\xff\xfe\x00",
    "not a number": b'{"sent_at": NaN, "reports": [NaN]}',
    "deep": b"[" * 100_000,
    "no reports": b'{"sent_at": "2026-01-01T00:00:00Z", "reports": []}',
    "naive time": b'{"sent_at": "2026-01-01T00:00:00", "reports": [{}]}',
    "lone surrogate": b'{"sent_at": 1, "\\ud800": 1, "reports": [{"\\udfff": 1}]}',
    "huge number": b'{"sent_at": 1e400, "reports": [1' + b"0" * 5000 + b"]}",
    "list": b"[]",
}


@pytest.mark.parametrize("body", HOSTILE.values(), ids=HOSTILE.keys())
async def test_a_hostile_body_is_refused_as_a_problem(client: httpx.AsyncClient, body: bytes) -> None:
    answer = await client.post("/v1/observations", content=body, headers=JSON)
    assert 400 <= answer.status_code < 500, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["status"] == answer.status_code


WHAT_IS_SAID = {
    b'{"sent_at": "2026-01-01T00:00:00Z", "reports": []}': {"body.reports": "give at least 1"},
    b'{"sent_at": "2026-01-01T00:00:00Z", "reports": [5]}': {"body.reports.0": "Input should be an object"},
    b'{"sent_at": 1780315200, "reports": [5]}': {
        "body.sent_at": "write an RFC 3339 moment with its offset",
        "body.reports.0": "Input should be an object",
    },
    b'{"sent_at": "1780315200"}': {"body.sent_at": "write an RFC 3339 moment", "body.reports": "Field required"},
    b'{"a": 1} b': {"body": "no JSON in UTF-8: trailing characters at line 1 column 10"},
    b"": {"body": "no JSON in UTF-8: EOF"},
    b"\xff\xfe\x00": {"body": "no JSON in UTF-8: expected value at line 1 column 1"},
    b"[" * 100_000: {"body": "no JSON in UTF-8: recursion limit exceeded"},
}


@pytest.mark.parametrize("body", WHAT_IS_SAID)
async def test_a_refused_body_is_told_what_is_wrong_and_nothing_else(client: httpx.AsyncClient, body: bytes) -> None:
    answer = await client.post("/v1/observations", content=body, headers=JSON)
    told = {item["where"]: item["what"] for item in answer.json()["errors"]}
    assert answer.status_code == 422
    assert told.keys() == WHAT_IS_SAID[body].keys()
    assert all(told[where].startswith(what) for where, what in WHAT_IS_SAID[body].items())


async def test_who_may_not_post_is_told_so_before_the_body_is_read(client: httpx.AsyncClient) -> None:
    answer = await client.post("/v1/observations", content=b"{", headers=JSON | {"Authorization": "Bearer unknown"})
    assert answer.status_code == 401


@pytest.mark.parametrize(
    ("query", "status"),
    [
        ("/v1/obstacles?lat=1&lat=2&lon=0", 422),
        ("/v1/obstacles?bbox=0,0,1,1&limit=1&limit=1", 422),
        ("/v1/obstacles?lat=0&lon=0&kind=bump&kind=debris&state=removed&state=candidate", 200),
        ("/v1/obstacles/0198a000-0000-7000-8000-000000000000?f=denm&f=waze", 422),
        ("/v1/actions?limit=1&limit=2", 422),
        ("/ogc/collections/obstacles/items?limit=1&limit=2", 400),
        ("/ogc/collections/obstacles/items?kind=bump&kind=debris", 200),
    ],
)
async def test_what_cannot_add_up_is_given_once(client: httpx.AsyncClient, query: str, status: int) -> None:
    answer = await client.get(query)
    assert answer.status_code == status
    assert ("give it once" in answer.text) is (status != 200)


async def test_a_body_beyond_one_mebibyte_is_refused(client: httpx.AsyncClient) -> None:
    answer = await client.post("/v1/observations", content=b" " * (MAX_BODY_BYTES + 1), headers=JSON)
    assert (answer.status_code, answer.json()["type"]) == (413, "urn:headsup:problem:body-too-large")


async def test_unknown_routes_and_methods_are_problems(client: httpx.AsyncClient) -> None:
    answers = [await client.get("/v1/nothing"), await client.delete("/v1/observations")]
    assert [answer.status_code for answer in answers] == [404, 405]
    assert {answer.headers["content-type"] for answer in answers} == {"application/problem+json"}


async def test_health_readiness_and_documentation(client: httpx.AsyncClient) -> None:
    assert [(await client.get(path)).status_code for path in ("/healthz", "/readyz", "/docs")] == [200, 200, 200]
    document = (await client.get("/openapi.json")).json()
    assert {"ObservationBatch", "ObservationBatchResult", "ObstacleCollection"} <= document["components"][
        "schemas"
    ].keys()


async def test_with_a_key_nobody_is_served_without_one(guarded: Settings) -> None:
    async with serving(guarded) as client:
        refused = [await client.get("/v1/obstacles?lat=0&lon=0", headers=headers) for headers in REFUSED]
        served = await client.get("/v1/obstacles?lat=0&lon=0", headers=BEARER)
    assert [answer.status_code for answer in refused] == [401] * len(REFUSED)
    assert {answer.headers["www-authenticate"] for answer in refused} == {"Bearer"}
    assert served.status_code == 200


REFUSED = [{}, {"Authorization": "Bearer wrong"}, {"Authorization": "Bearer "}, {"Authorization": OPERATOR_KEY}]
