"""`HEAD`: what `GET` would answer, without the body."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest

from server.settings import Settings
from tests.integration.raw import exchanged, served_here

# They name the request or the moment, and differ from one answer to the next.
_OF_THE_REQUEST = {"date", "x-request-id", "traceparent"}
NEARBY = "/v1/obstacles?lat=38.2&lon=21.7&radius_m=300"


@pytest.fixture
async def port(tmp_path: Path) -> AsyncIterator[int]:
    async with served_here(Settings(database_url=f"sqlite+aiosqlite:///{tmp_path}/headsup.sqlite3")) as (_, port):
        yield port


@pytest.mark.parametrize(
    "path",
    [NEARBY, f"{NEARBY}&kind=pothole", "/v1/obstacles/nothing", "/healthz", "/openapi.json", "/ogc/collections"],
)
async def test_head_answers_the_status_and_headers_of_get(port: int, path: str) -> None:
    async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{port}") as client:
        asked, got = await client.head(path), await client.get(path)
    assert (asked.status_code, asked.content) == (got.status_code, b"")
    assert got.content
    known = [{k: v for k, v in answer.headers.items() if k not in _OF_THE_REQUEST} for answer in (asked, got)]
    assert known[0] == known[1]


async def test_no_byte_follows_the_headers_of_a_head_and_the_connection_goes_on(port: int) -> None:
    head = f"HEAD {NEARBY} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode()
    last = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    answer = await exchanged(port, [head, last])
    first, _, rest = answer.partition(b"\r\n\r\n")
    assert first.startswith(b"HTTP/1.1 200")
    assert rest.startswith(b"HTTP/1.1 200")


async def test_a_head_is_counted_as_a_head_of_its_route(port: int) -> None:
    async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{port}") as client:
        await client.head(NEARBY)
        metrics = (await client.get("/metrics")).text
    assert [line for line in metrics.splitlines() if 'method="HEAD"' in line and 'route="/v1/obstacles"' in line]


async def test_head_where_nothing_can_be_got_is_refused_as_get_is(port: int) -> None:
    async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{port}") as client:
        answer = await client.head("/v1/observations")
    assert (answer.status_code, answer.headers["allow"]) == (405, "POST")
