"""What /metrics counts, and for whom."""

from __future__ import annotations

import asyncio
from pathlib import Path

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families
from pydantic import SecretStr

from server.settings import Settings
from server.trust.keys import Role
from tests.integration.asking import AROUND_PATRAS, ago, created, obstacles, posted
from tests.integration.conftest import OPERATOR_KEY
from tests.integration.keys_of import bearer, client_of, keyed, opened
from tests.unit.server.making import absent, detection, message


@pytest.fixture
def open_server(tmp_path: Path) -> Settings:
    return Settings(database_url=f"sqlite+aiosqlite:///{tmp_path}/headsup.sqlite3")


@pytest.fixture
def guarded_server(open_server: Settings) -> Settings:
    return open_server.model_copy(update={"bootstrap_operator_key": SecretStr(OPERATOR_KEY)})


async def measured(client: httpx.AsyncClient) -> dict[str, float]:
    """Samples by name and labels."""
    answer = await client.get("/metrics")
    assert answer.status_code == 200, answer.text
    assert answer.headers["Content-Type"].startswith("text/plain; version=0.0.4")
    found = {}
    for family in text_string_to_metric_families(answer.text):
        assert family.documentation, family.name
        for sample in family.samples:
            labels = ",".join(f"{name}={value}" for name, value in sorted(sample.labels.items()))
            found[f"{sample.name}{{{labels}}}" if labels else sample.name] = sample.value
    return found


async def test_reports_decisions_and_events_are_counted(open_server: Settings) -> None:
    async with opened(open_server) as app, client_of(app) as client:
        report = message(detection(0, 0), detection(30, 0), at=ago(5))
        ids = await created(client, report)
        await posted(client, report)
        await posted(client, message(detection(0, 0, 1_500), at=ago(4), vehicle="car2", number=1))
        await posted(client, message(inspections=(absent(ids[1]),), at=ago(3), number=2))
        await posted(client, message(at=ago(24 * 30), number=3))
        await client.post(f"/v1/obstacles/{ids[0]}/actions", json={"action": "repaired"})
        found = await measured(client)
    assert found["headsup_reports_total{status=accepted}"] == 3
    assert found["headsup_reports_total{status=duplicate}"] == 1
    assert found["headsup_reports_total{status=rejected}"] == 1
    assert found["headsup_decisions_total{decision=created}"] == 2
    assert found["headsup_inspections_total{effect=removed}"] == 1
    assert found["headsup_events_total{what=absent}"] == 1
    assert found["headsup_events_total{what=operator}"] == 1
    assert found["headsup_ingest_group_count"] == 5
    assert found["headsup_ingest_group_sum"] == 5
    assert found["headsup_ingest_backlog"] == 0


async def test_nearby_queries_are_counted_with_what_they_had_to_read(open_server: Settings) -> None:
    async with opened(open_server) as app, client_of(app) as client:
        await created(client, message(detection(), at=ago(2)))
        for _ in range(3):
            await obstacles(client, **AROUND_PATRAS)
        await posted(client, message(detection(), at=ago(1), vehicle="car2"))
        await asyncio.gather(*(obstacles(client, **AROUND_PATRAS) for _ in range(10)))
        found = await measured(client)
    assert found["headsup_nearby_queries_total"] == 13
    assert 4 <= found["headsup_nearby_version_checks_total"] < 13
    assert found["headsup_nearby_tiles_total{found=loaded}"] == 1
    assert found["headsup_nearby_tiles_total{found=changed}"] == 1
    assert found["headsup_nearby_cache_bytes"] > 500


async def test_answers_are_timed_by_route_and_class_of_status_and_never_by_what_was_asked(
    open_server: Settings,
) -> None:
    async with opened(open_server) as app, client_of(app) as client:
        (identifier,) = await created(client, message(detection(), at=ago(2)))
        for path in (
            f"/v1/obstacles/{identifier}",
            "/v1/obstacles/38.2466",
            "/secret/path",
            "/v1/obstacles?lat=1&lon=2",
        ):
            await client.get(path)
        await client.request("BREW", "/v1/obstacles")
        found = await measured(client)
        text = (await client.get("/metrics")).text
    counts = {name: value for name, value in found.items() if name.startswith("headsup_request_seconds_count")}
    assert counts == {
        "headsup_request_seconds_count{method=POST,route=/v1/observations,status=2xx}": 1,
        "headsup_request_seconds_count{method=GET,route=/v1/obstacles/{obstacle_id},status=2xx}": 1,
        "headsup_request_seconds_count{method=GET,route=/v1/obstacles/{obstacle_id},status=4xx}": 1,
        "headsup_request_seconds_count{method=GET,route=none,status=4xx}": 1,
        "headsup_request_seconds_count{method=GET,route=/v1/obstacles,status=2xx}": 1,
        "headsup_request_seconds_count{method=other,route=/v1/obstacles,status=4xx}": 1,
    }
    assert not [secret for secret in (str(identifier), "38.24", "secret", "BREW") if secret in text]


async def test_buckets_rise_to_the_count(open_server: Settings) -> None:
    async with opened(open_server) as app, client_of(app) as client:
        for _ in range(5):
            await client.get("/healthz")
        found = await measured(client)
    labels = "method=GET,route=/healthz,status=2xx"
    buckets = [value for name, value in found.items() if name.startswith("headsup_request_seconds_bucket")]
    assert buckets == sorted(buckets)
    assert buckets[-1] == found[f"headsup_request_seconds_count{{{labels}}}"] == 5


async def test_metrics_are_for_operators_unless_this_machine_may_read_them(guarded_server: Settings) -> None:
    seen = {}
    for access in ("operator", "loopback", "off"):
        async with opened(guarded_server.model_copy(update={"metrics": access})) as app:
            (reader,) = await keyed(app, Role.READER)
            async with client_of(app, "127.0.0.1") as here, client_of(app, "203.0.113.5") as there:
                asked = [
                    await there.get("/metrics", headers=bearer(OPERATOR_KEY)),
                    await there.get("/metrics", headers=bearer(reader)),
                    await there.get("/metrics"),
                    await here.get("/metrics"),
                    await here.get("/metrics", headers={"X-Forwarded-For": "203.0.113.5"}),
                ]
                seen[access] = [answer.status_code for answer in asked]
    assert seen == {
        "operator": [200, 403, 401, 401, 401],
        "loopback": [200, 403, 401, 200, 401],
        "off": [404, 404, 404, 404, 404],
    }


async def test_refusals_by_a_limit_are_counted(guarded_server: Settings) -> None:
    few = guarded_server.model_copy(update={"failed_keys_per_minute": 2.0})
    async with opened(few) as app, client_of(app) as client:
        for _ in range(5):
            await client.get("/v1/actions")
        client.headers.update(bearer(OPERATOR_KEY))
        async with client_of(app, "198.51.100.7") as operator:
            operator.headers.update(bearer(OPERATOR_KEY))
            found = await measured(operator)
    assert found["headsup_refused_total{limit=failed-keys}"] == 3
