"""OGC API - Features: what the standard asks for, on both databases, and a real GIS program as its reader."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from uuid import uuid4

import httpx
import pytest

from contract.geometry import Kind
from contract.observation import ObservationBatch, State
from server.ogc.models import Conformance, Items, SingleItem
from tests.integration.asking import JSON, ago, created, near, pages, posted
from tests.unit.server.making import PATRAS, detection, message

ITEMS = "/ogc/collections/obstacles/items"
KEY = "a-key-of-the-ogc-tests-0123456789-0123456789"
PROGRAM = "from headsup.server_commands import serve; import typer; typer.run(serve)"


async def items(client: httpx.AsyncClient, **query: Any) -> Items:
    answer = await client.get(ITEMS, params=query)
    assert (answer.status_code, answer.headers["content-type"]) == (200, "application/geo+json"), answer.text
    return Items.model_validate_json(answer.content)


async def thirty(client: httpx.AsyncClient) -> list[str]:
    seen = [detection(16 * (n % 6), 16 * (n // 6), kind=[*Kind][n % 3]) for n in range(30)]
    return [str(identifier) for identifier in await created(client, message(*seen, at=ago(2)))]


async def test_from_the_landing_page_every_link_leads_somewhere(client: httpx.AsyncClient) -> None:
    await thirty(client)
    to_visit, seen = ["http://localhost/ogc"], set()
    while to_visit:
        address = to_visit.pop()
        seen.add(address)
        answer = await client.get(address)
        assert answer.status_code == 200, address
        if not answer.headers["content-type"].startswith(("application/json", "application/geo+json")):
            continue
        found = answer.json()
        links = [*found.get("links", []), *(link for item in found.get("collections", []) for link in item["links"])]
        for link in links:
            assert link["href"].startswith("http://localhost/")
            assert {"rel", "type", "title"} <= link.keys()
        to_visit += [link["href"] for link in links if link["href"] not in {*seen, *to_visit}]
    assert len(seen) >= 9


async def test_it_says_what_it_conforms_to(client: httpx.AsyncClient) -> None:
    found = Conformance.model_validate_json((await client.get("/ogc/conformance")).content)
    for name in ("core", "geojson"):
        assert f"http://www.opengis.net/spec/ogcapi-features-1/1.0/conf/{name}" in found.conformsTo


async def test_a_page_has_ten_items_unless_it_says_otherwise(client: httpx.AsyncClient) -> None:
    ids = await thirty(client)
    page = await items(client)
    assert (page.numberReturned, len(page.features)) == (10, 10)
    assert abs(page.timeStamp - datetime.now(UTC)) < timedelta(minutes=1)
    assert [link.rel for link in page.links] == ["self", "next", "collection"]
    raw = (await client.get(ITEMS)).json()
    assert "numberMatched" not in raw
    assert (await items(client, count="true", limit=3)).numberMatched == 30
    for limit in (7, 10_000):
        found = await pages(client, ITEMS, limit=limit)
        assert sorted(item["id"] for page in found for item in page["features"]) == sorted(ids)


async def test_properties_are_flat_and_in_metres(client: httpx.AsyncClient) -> None:
    await created(client, message(detection(), at=ago(1)))
    (item,) = (await client.get(ITEMS)).json()["features"]
    properties = item["properties"]
    assert not [name for name, value in properties.items() if isinstance(value, dict | list)]
    assert (properties["length_m"], properties["width_m"], properties["relief_m"]) == (1.0, 0.7, 0.1)
    assert properties["yaw_deg"] == pytest.approx(17.189, abs=1e-3)
    single = SingleItem.model_validate_json((await client.get(f"{ITEMS}/{item['id']}")).content)
    assert single.model_dump(mode="json", exclude={"links"}) == item
    assert [link.rel for link in single.links] == ["self", "alternate", "collection"]


async def test_boxes_times_and_filters(client: httpx.AsyncClient) -> None:
    old, fresh = await created(
        client,
        message(detection(0, 0), at=ago(100), vehicle="a"),
        message(detection(60, 0, kind=Kind.BUMP), at=ago(1), vehicle="b", altitude_m=500),
    )
    await posted(client, message(detection(0, 0), at=ago(90), vehicle="c"))
    expected: dict[tuple[str, str], set[object]] = {
        ("bbox", "21.7,38.2,21.8,38.3"): {old, fresh},
        ("bbox", "21.7,38.2,21.7349,38.3"): {old},
        ("bbox", "21.8,38.2,21.7,38.3"): set(),
        ("bbox", "21.7,38.2,-100,21.8,38.3,100"): {old},
        ("bbox", "21.7,38.2,400,21.8,38.3,600"): {fresh},
        ("datetime", f"{ago(50).isoformat()}/.."): {fresh},
        ("datetime", f"../{ago(50).isoformat()}"): {old},
        ("datetime", ago(95).isoformat()): {old},
        ("datetime", f"{ago(80).isoformat()}/{ago(50).isoformat()}"): set(),
        ("kind", "bump"): {fresh},
        ("state", State.CONFIRMED.value): {old},
    }
    for (name, value), ids in expected.items():
        page = await items(client, **{name: value}, count="true")
        assert {item.id for item in page.features} == ids, (name, value)
        assert page.numberMatched == len(ids)


async def test_what_the_standard_refuses_is_a_bad_request(client: httpx.AsyncClient) -> None:
    for query in (
        "limit=0",
        "limit=10001",
        "bbox=1,2,3",
        "bbox=0,5,1,2",
        "datetime=now",
        "foo=bar",
        "cursor=x",
        "f=xml",
    ):
        answer = await client.get(f"{ITEMS}?{query}")
        assert (answer.status_code, answer.headers["content-type"]) == (400, "application/problem+json"), query
        assert query.partition("=")[0] in answer.json()["detail"], query
    for path in ("/ogc", "/ogc/conformance", "/ogc/collections", "/ogc/collections/obstacles"):
        assert (await client.get(f"{path}?foo=bar")).status_code == 400
    for path in ("/ogc/collections/roads", "/ogc/collections/roads/items", f"{ITEMS}/{uuid4()}", f"{ITEMS}/nonsense"):
        assert (await client.get(path)).status_code == 404


async def test_a_strange_host_is_refused_and_not_repeated(client: httpx.AsyncClient) -> None:
    for host in ("[::1", "a b", 'evil"><script>', "[", ":"):
        answer = await client.get("/ogc", headers={"Host": host})
        assert answer.status_code in (400, 401)
        assert "<script>" not in answer.text


@contextmanager
def serving(folder: Path) -> Iterator[str]:
    """A server process with a key on a free port."""
    environment = os.environ | {
        "HEADSUP_DATABASE_URL": f"sqlite+aiosqlite:///{folder}/headsup.sqlite3",
        "HEADSUP_BOOTSTRAP_OPERATOR_KEY": KEY,
    }
    command = [sys.executable, "-c", PROGRAM, "--port", "0"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment
    ) as process:
        try:
            assert process.stdout is not None
            yield process.stdout.readline().split()[2]
        finally:
            process.kill()


@pytest.mark.skipif(shutil.which("ogr2ogr") is None, reason="ogr2ogr is not installed (Debian: gdal-bin)")
def test_ogr2ogr_copies_every_obstacle(tmp_path: Path) -> None:
    reports = [
        message(
            *(detection(10 * (n % 8), 10 * (n // 8)) for n in range(60)),
            at=ago(3 - place),
            position=near(PATRAS.latitude_deg + 0.01 * place, PATRAS.longitude_deg),
        )
        for place in range(3)
    ]
    with serving(tmp_path) as url:
        with httpx.Client(base_url=url, headers={"Authorization": f"Bearer {KEY}"}, trust_env=False) as client:
            batch = ObservationBatch(sent_at=datetime.now(UTC), reports=reports)
            assert client.post("/v1/observations", content=batch.model_dump_json(), headers=JSON).status_code == 200
            served = client.get("/v1/obstacles", params={"bbox": "21,38,22,39"}).json()["features"]
        described = gdal("ogrinfo", "-so", f"OAPIF:{url}/ogc", "obstacles")
        copied = copied_by_ogr(url, tmp_path / "copy.geojson", "-oo", "PAGE_SIZE=50")
        boxed = copied_by_ogr(url, tmp_path / "box.geojson", "-spat", "21.7", "38.25", "21.8", "38.3")
    assert len(served) == 180
    assert "length_m: Real" in described
    assert "first_seen: DateTime" in described
    assert {row["properties"]["revision"] for row in copied} == {1}
    assert places(copied) == places(served)
    assert {row["properties"]["kind"] for row in copied} == {"pothole"}
    north = [item for item in served if item["geometry"]["coordinates"][1] >= 38.25]
    assert 0 < len(north) < 180
    assert places(boxed) == places(north)


def gdal(*command: str) -> str:
    environment = os.environ | {"GDAL_HTTP_HEADERS": f"Authorization: Bearer {KEY}", "NO_PROXY": "*"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    assert "ERROR" not in done.stderr
    return done.stdout


def copied_by_ogr(url: str, target: Path, *options: str) -> list[dict[str, Any]]:
    """Every feature that ogr2ogr reads and writes."""
    gdal("ogr2ogr", str(target), f"OAPIF:{url}/ogc", "obstacles", *options)
    return list(json.loads(target.read_text())["features"])


def places(features: list[dict[str, Any]]) -> list[tuple[float, ...]]:
    return sorted(tuple(round(number, 6) for number in item["geometry"]["coordinates"]) for item in features)
