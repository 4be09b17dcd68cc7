"""Bodies on the wire: refused as early as can be, and told so."""

from __future__ import annotations

import gzip
from collections.abc import AsyncIterator, Iterator
from itertools import repeat
from pathlib import Path

import httpx
import pytest

from contract.observation import MAX_BODY_BYTES
from server.settings import Settings
from tests.integration.asking import JSON, ago
from tests.integration.raw import exchanged, served_here, status_of
from tests.integration.test_server_trust import batch
from tests.unit.server.making import detection, message

POST = b"POST /v1/observations HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"


@pytest.fixture
async def port(tmp_path: Path) -> AsyncIterator[int]:
    async with served_here(Settings(database_url=f"sqlite+aiosqlite:///{tmp_path}/headsup.sqlite3")) as (_, port):
        yield port


@pytest.fixture
async def client(port: int) -> AsyncIterator[httpx.AsyncClient]:
    async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{port}", trust_env=False) as client:
        yield client


@pytest.mark.parametrize("length", [MAX_BODY_BYTES + 1, 10**17, 10**30])
async def test_a_length_beyond_the_limit_is_refused_before_a_byte_of_the_body(port: int, length: int) -> None:
    for expects in (b"", b"Expect: 100-continue\r\n"):
        answer = await exchanged(port, [POST + expects + b"Content-Length: %d\r\n\r\n" % length], until=b"}")
        # The parser takes no length beyond 64 bits.
        assert status_of(answer) == (400 if length > 2**64 else 413)
        assert b"connection: close" in answer
        assert b"100 Continue" not in answer


async def test_whoever_waits_is_told_to_go_on_when_the_body_fits(port: int) -> None:
    head = POST + b"Expect: 100-continue\r\nConnection: close\r\nContent-Length: 2\r\n\r\n"
    answer = await exchanged(port, [head, b"{}"])
    assert answer.startswith(b"HTTP/1.1 100 Continue\r\n\r\nHTTP/1.1 422 ")


async def test_a_body_without_end_is_cut_off_and_the_connection_closed(port: int) -> None:
    sent = 0

    def chunks() -> Iterator[bytes]:
        nonlocal sent
        yield POST + b"Transfer-Encoding: chunked\r\n\r\n"
        for chunk in repeat(b"10000\r\n" + b" " * 65_536 + b"\r\n", 2_000):
            sent += len(chunk)
            yield chunk

    answer = await exchanged(port, chunks())
    assert (status_of(answer), answer.count(b"HTTP/1.1")) == (413, 1)
    assert sent < 60_000_000


async def test_a_client_that_sends_all_before_it_reads_still_hears_why(client: httpx.AsyncClient) -> None:
    async def pieces() -> AsyncIterator[bytes]:
        for _ in range(60):
            yield b" " * 65_536

    for body in (b" " * 4_000_000, pieces()):
        answer = await client.post("/v1/observations", content=body, headers=JSON)
        assert (answer.status_code, answer.json()["type"]) == (413, "urn:headsup:problem:body-too-large")
    # On a new connection.
    assert (await client.get("/healthz")).status_code == 200


async def test_a_compressed_body_is_refused_with_what_would_be_taken(client: httpx.AsyncClient) -> None:
    body = batch(message(detection(), at=ago(1))).encode()
    for encoding, sent in {"gzip": gzip.compress(body), "GZIP, br": body, "nonsense": body}.items():
        answer = await client.post("/v1/observations", content=sent, headers=JSON | {"Content-Encoding": encoding})
        assert (answer.status_code, answer.json()["type"]) == (415, "urn:headsup:problem:unsupported-media-type")
        assert (answer.headers["Accept"], answer.headers["Accept-Encoding"]) == ("application/json", "identity")
    plain = await client.post("/v1/observations", content=body, headers=JSON | {"Content-Encoding": "identity"})
    assert plain.status_code == 200
