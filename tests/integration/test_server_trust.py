"""Who is let in, how often, and what an answer tells a browser."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import httpx
import pytest
from pydantic import SecretStr

from contract.observation import MAX_BODY_BYTES, ObservationBatch, ObservationReport
from server.settings import Settings
from server.trust.key_owners import KeyOwners
from server.trust.keys import Keys, Role
from server.web import readiness
from tests.integration.asking import AROUND_PATRAS, JSON, ago
from tests.integration.conftest import OPERATOR_KEY
from tests.integration.keys_of import bearer, client_of, keyed, opened
from tests.unit.server.making import detection, message


@pytest.fixture
def limited(tmp_path: Path) -> Settings:
    """A guarded server on SQLite whose rates are so low that a test does not refill them."""
    return Settings(
        database_url=f"sqlite+aiosqlite:///{tmp_path}/headsup.sqlite3",
        bootstrap_operator_key=SecretStr(OPERATOR_KEY),
        vehicle_rate_hz=0.001,
        reader_rate_hz=0.002,
        operator_rate_hz=1_000,
        report_rate_hz=0.05,
        rate_burst_s=3_000,
        failed_keys_per_minute=3,
    )


def problem(answer: httpx.Response) -> tuple[int, str]:
    return answer.status_code, answer.json()["type"].removeprefix("urn:headsup:problem:")


async def test_a_key_over_its_rate_is_told_when_to_come_back_and_others_are_served(limited: Settings) -> None:
    async with opened(limited) as app, client_of(app) as client:
        first, second, reader = await keyed(app, Role.VEHICLE, Role.VEHICLE, Role.READER)

        async def asks(key: str) -> httpx.Response:
            return await client.get("/v1/obstacles", params=AROUND_PATRAS, headers=bearer(key))

        answers = [await asks(first) for _ in range(4)]
        assert [answer.status_code for answer in answers] == [200, 200, 200, 429]
        assert problem(answers[-1]) == (429, "too-many-requests")
        assert 900 <= int(answers[-1].headers["Retry-After"]) <= 1_000
        assert (await asks(second)).status_code == 200
        assert [(await asks(reader)).status_code for _ in range(7)] == [200] * 6 + [429]
        assert [(await asks(OPERATOR_KEY)).status_code for _ in range(20)] == [200] * 20


async def test_every_route_counts_against_the_rate(limited: Settings) -> None:
    async with opened(limited) as app, client_of(app) as client:
        (key,) = await keyed(app, Role.VEHICLE)
        for path in ("/v1/obstacles?lat=0&lon=0", "/v1/obstacles?bbox=0,0,1,1", "/ogc/collections/obstacles/items"):
            assert (await client.get(path, headers=bearer(key))).status_code == 200
        for path in ("/v1/obstacles?lat=0&lon=0", "/v1/obstacles?bbox=0,0,1,1", "/v1/actions"):
            assert (await client.get(path, headers=bearer(key))).status_code == 429


async def test_a_request_that_goes_through_two_routes_counts_once(limited: Settings) -> None:
    async with opened(limited) as app, client_of(app) as client:
        two = batch(message(detection(0, 0), detection(30, 0), at=ago(1)))
        assert (await client.post("/v1/observations", content=two, headers=JSON | bearer(OPERATOR_KEY))).is_success
        (key,) = await keyed(app, Role.VEHICLE)
        # Nearby queries are answered from memory unless they have more than one page.
        asked = [
            await client.get("/v1/obstacles", params={**AROUND_PATRAS, "limit": 1}, headers=bearer(key))
            for _ in range(4)
        ]
        assert [answer.status_code for answer in asked] == [200, 200, 200, 429]
        assert "next" in asked[0].headers["Link"]


async def test_reports_are_limited_by_their_number(limited: Settings) -> None:
    async with opened(limited) as app, client_of(app) as client:
        reports = [message(at=ago(1 + n / 100), number=n) for n in range(80)]
        bodies = [batch(*reports[:75]), batch(*reports[:75]), batch(*reports[:1])]
        answers = [
            await client.post("/v1/observations", content=body, headers=JSON | bearer(OPERATOR_KEY)) for body in bodies
        ]
        assert [answer.status_code for answer in answers] == [200, 200, 429]
        assert 1 <= int(answers[-1].headers["Retry-After"]) <= 21


async def test_unknown_keys_of_one_address_are_limited_and_good_keys_of_it_are_served(limited: Settings) -> None:
    """Also keys that the server has never seen: an attacker behind the same proxy locks nobody out."""
    async with opened(limited) as app:
        (good,) = await keyed(app, Role.READER)
        async with client_of(app, "203.0.113.5") as attacker, client_of(app, "198.51.100.7") as other:
            tried = [await attacker.get("/v1/actions", headers=bearer(f"guess{n}")) for n in range(5)]
            assert [answer.status_code for answer in tried] == [401, 401, 401, 429, 429]
            assert 1 <= int(tried[-1].headers["Retry-After"]) <= 20
            assert (await attacker.get("/v1/actions")).status_code == 429
            assert (await attacker.get("/v1/obstacles/x", headers=bearer(good))).status_code == 422
            assert (await other.get("/v1/actions", headers=bearer("guess"))).status_code == 401


async def test_many_unknown_keys_at_once_share_statements_and_leave_the_database_to_others(
    limited: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    statements: list[int] = []
    reads = KeyOwners._read

    async def counted(owners: KeyOwners, hashes: list[str]) -> Mapping[str, tuple[str, str]]:
        statements.append(len(hashes))
        return await reads(owners, hashes)

    monkeypatch.setattr(KeyOwners, "_read", counted)
    async with opened(limited) as app, client_of(app) as client:
        (good,) = await keyed(app, Role.READER)
        keys = [f"guess{n}" for n in range(200)] + [good]
        answers = await asyncio.gather(*(client.get("/v1/obstacles/x", headers=bearer(key)) for key in keys))
    assert answers[-1].status_code == 422
    assert Counter(answer.status_code for answer in answers[:-1]) == {401: 3, 429: 197}
    assert sum(statements) == 201
    assert len(statements) <= 3


async def test_many_requests_at_once_share_the_question_whether_there_are_keys(
    limited: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Keys] = []
    asks = Keys._any_in_database

    async def counted(keys: Keys) -> bool:
        asked.append(keys)
        await asyncio.sleep(0.01)
        return await asks(keys)

    monkeypatch.setattr(Keys, "_any_in_database", counted)
    async with opened(limited.model_copy(update={"bootstrap_operator_key": None})) as app, client_of(app) as client:
        asked.clear()
        answers = await asyncio.gather(*(client.get("/v1/obstacles/x") for _ in range(100)))
        assert {answer.status_code for answer in answers} == {422}
        assert len(asked) == 1
        await app.state.parts.keys.create(Role.READER, "the first one")
        app.state.parts.keys._remembered.clear()
        refused = await asyncio.gather(*(client.get("/v1/obstacles/x") for _ in range(100)))
        assert {answer.status_code for answer in refused} <= {401, 429}
        assert len(asked) == 2


async def test_addresses_of_one_ipv6_network_are_one(limited: Settings) -> None:
    async with opened(limited) as app:
        statuses = []
        for number in range(4):
            async with client_of(app, f"2001:db8:0:1::{number}") as client:
                statuses.append((await client.get("/v1/actions")).status_code)
        async with client_of(app, "2001:db8:0:2::1") as client:
            statuses.append((await client.get("/v1/actions")).status_code)
    assert statuses == [401, 401, 401, 429, 401]


async def test_a_server_without_keys_has_no_limits_but_serves_no_proxy(limited: Settings) -> None:
    alone = limited.model_copy(update={"bootstrap_operator_key": None})
    async with opened(alone) as app, client_of(app) as client:
        answers = await asyncio.gather(*(client.get("/v1/obstacles?lat=0&lon=0") for _ in range(50)))
        assert {answer.status_code for answer in answers} == {200}
        strange = [
            *({"X-Forwarded-For": "203.0.113.5"}, {"Forwarded": "for=203.0.113.5"}, {"Via": "1.1 proxy"}),
            *({"Host": host} for host in ("evil.example", "localhost.evil.example:80", "10.0.0.1", "[::2]", "a b")),
        ]
        for header in strange:
            assert problem(await client.get("/v1/obstacles?lat=0&lon=0", headers=header)) == (401, "unauthenticated")
        for host in ("localhost:8000", "127.0.0.1", "[::1]:80", "LOCALHOST"):
            assert (await client.get("/v1/obstacles?lat=0&lon=0", headers={"Host": host})).status_code == 200


async def answers_of_all_kinds(client: httpx.AsyncClient) -> dict[str, httpx.Response]:
    key = bearer(OPERATOR_KEY)
    near = await client.get("/v1/obstacles", params=AROUND_PATRAS, headers=key)
    too_much = b" " * (MAX_BODY_BYTES + 1)
    return {
        "near": near,
        "unchanged": await client.get(
            "/v1/obstacles", params=AROUND_PATRAS, headers=key | {"If-None-Match": near.headers["ETag"]}
        ),
        "page": await client.get("/v1/obstacles?bbox=0,0,1,1", headers=key),
        "unauthenticated": await client.get("/v1/obstacles?lat=0&lon=0"),
        "invalid": await client.get("/v1/obstacles?lat=95&lon=0", headers=key),
        "no route": await client.get("/wp-admin"),
        "no method": await client.put("/v1/obstacles"),
        "too large": await client.post("/v1/observations", content=too_much, headers=JSON | key),
        "health": await client.get("/healthz"),
        "viewer": await client.get("/docs"),
    }


async def test_every_answer_is_named_and_tells_browsers_to_do_nothing_with_it(limited: Settings) -> None:
    async with opened(limited) as app, client_of(app) as client:
        app.add_api_route("/fault", fault)
        answers = await answers_of_all_kinds(client) | {"fault": await client.get("/fault")}
    names = set()
    for kind, answer in answers.items():
        assert answer.headers["X-Content-Type-Options"] == "nosniff", kind
        assert answer.headers["Referrer-Policy"] == "no-referrer", kind
        assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"], kind
        assert answer.headers["Content-Security-Policy"].startswith("default-src 'none'"), kind
        assert not {"server", "access-control-allow-origin"} & set(answer.headers), kind
        names.add(answer.headers["X-Request-Id"])
    assert len(names) == len(answers)
    assert [answers[kind].status_code for kind in ("unchanged", "no route", "no method", "too large", "fault")] == [
        304,
        404,
        405,
        413,
        500,
    ]
    assert "secret text" not in answers["fault"].text
    assert "script-src" in answers["viewer"].headers["Content-Security-Policy"]
    assert "script-src" not in answers["near"].headers["Content-Security-Policy"]


async def fault() -> None:
    raise RuntimeError("secret text")


async def test_names_and_traces_come_back(limited: Settings) -> None:
    trace = "ab" * 16
    async with opened(limited) as app, client_of(app) as client:
        named = await client.get("/healthz", headers={"X-Request-Id": "req-7"})
        traced = await client.get("/healthz", headers={"traceparent": f"00-{trace}-{'cd' * 8}-01"})
    assert named.headers["X-Request-Id"] == "req-7"
    assert "traceparent" not in named.headers
    assert traced.headers["traceparent"].split("-")[1] == trace
    assert "cd" * 8 not in traced.headers["traceparent"]


async def test_only_pages_of_named_origins_may_read(limited: Settings) -> None:
    open_to_map = limited.model_copy(update={"cors_origins": ("https://map.example",)})
    asked = {"Origin": "https://map.example", **bearer(OPERATOR_KEY)}
    async with opened(open_to_map) as app, client_of(app) as client:
        allowed = await client.get("/v1/obstacles?lat=0&lon=0", headers=asked)
        stranger = await client.get("/v1/obstacles?lat=0&lon=0", headers=asked | {"Origin": "https://evil.example"})
        preflight = await client.options(
            "/v1/obstacles",
            headers={
                "Origin": "https://map.example",
                "Access-Control-Request-Method": "GET",
                "Access-Control-Request-Headers": "authorization",
            },
        )
        writing = await client.options(
            "/v1/observations", headers={"Origin": "https://map.example", "Access-Control-Request-Method": "POST"}
        )
    assert allowed.headers["Access-Control-Allow-Origin"] == "https://map.example"
    assert "Access-Control-Allow-Origin" not in stranger.headers
    assert preflight.status_code == 200
    assert writing.status_code == 400


def batch(*reports: ObservationReport) -> str:
    return ObservationBatch(sent_at=datetime.now(UTC), reports=reports).model_dump_json()


async def test_a_server_whose_database_does_not_answer_is_not_ready(
    limited: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with opened(limited) as app, client_of(app) as client:
        assert (await client.get("/readyz")).json() == {"status": "ready"}
        monkeypatch.setattr(readiness, "_WITHIN_S", 0.0)
        assert problem(await client.get("/readyz")) == (503, "unavailable")
        assert (await client.get("/healthz")).status_code == 200
