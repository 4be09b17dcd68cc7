"""The line and headers of a request: bounded in size and time, whatever sends them."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from itertools import repeat
from pathlib import Path

import httpx
import pytest

from server.settings import Settings
from server.web import http_protocol
from server.web.http_protocol import MAX_FIELDS, MAX_HEAD_BYTES, MAX_LINE_BYTES
from tests.integration.raw import exchanged, served_here, status_of

GET = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n"
UPGRADE = (
    b"GET /v1/events HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
)
CHUNKED = b"POST /v1/observations HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n1\r\n \r\n0\r\n"


@pytest.fixture
async def port(tmp_path: Path) -> AsyncIterator[int]:
    async with served_here(Settings(database_url=f"sqlite+aiosqlite:///{tmp_path}/headsup.sqlite3")) as (_, port):
        yield port


def endless(start: bytes, part: bytes) -> Iterator[bytes]:
    """60 MB in pieces."""
    yield start
    yield from repeat(part * (65_536 // len(part)), 60_000_000 // 65_536)


@pytest.mark.parametrize(
    ("start", "part"),
    [
        (GET + b"X-Long: ", b"x"),
        (GET, b"X-Many: x\r\n"),
        (b"GET /", b"x"),
        (b"GET /?", b"x=1&"),
        (UPGRADE + b"X-Long: ", b"x"),
        (CHUNKED + b"X-Trailer: ", b"x"),
        (CHUNKED, b"X-Trailer: x\r\n"),
        (CHUNKED[: -len(b"0\r\n")] + b"1;", b"x"),
    ],
    ids=["a field", "fields", "a path", "a query", "a handshake", "a trailer", "trailers", "an extension"],
)
async def test_a_head_without_end_is_cut_off(port: int, start: bytes, part: bytes) -> None:
    sent = 0

    def counted() -> Iterator[bytes]:
        nonlocal sent
        for piece in endless(start, part):
            sent += len(piece)
            yield piece

    assert status_of(await exchanged(port, counted())) in (431, 400)
    # The rest is what the sockets' buffers hold.
    assert sent < 20_000_000


@pytest.mark.parametrize("start", [GET, UPGRADE], ids=["request", "handshake"])
@pytest.mark.parametrize("in_pieces", [False, True])
async def test_a_head_is_taken_up_to_the_limits(port: int, start: bytes, in_pieces: bool) -> None:
    longest = MAX_LINE_BYTES - len(b"X-Long: \r\n")
    heads = {
        start + b"X-Long: " + b"x" * longest + b"\r\n\r\n": True,
        start + b"X-Long: " + b"x" * (longest + 1) + b"\r\n\r\n": False,
        start + b"X-Many: x\r\n" * (MAX_FIELDS - 6) + b"\r\n": True,
        start + b"X-Many: x\r\n" * (MAX_FIELDS + 1) + b"\r\n": False,
        start + (b"X-Long: " + b"x" * 6_000 + b"\r\n") * (MAX_HEAD_BYTES // 6_100) + b"\r\n": True,
        start + (b"X-Long: " + b"x" * 6_000 + b"\r\n") * (MAX_HEAD_BYTES // 6_000 + 1) + b"\r\n": False,
    }
    for head, is_taken in heads.items():
        pieces = [head[at : at + 1_000] for at in range(0, len(head), 1_000)] if in_pieces else [head]
        # A handshake that was taken stays open.
        answer = await exchanged(port, pieces, until=b"\r\n\r\n" if is_taken else None)
        assert status_of(answer) == ((101 if start is UPGRADE else 200) if is_taken else 431), head[:200]
        if not is_taken:
            assert b"urn:headsup:problem:headers-too-large" in answer
            assert b"content-security-policy" in answer


async def test_requests_on_one_connection_are_each_measured_alone(port: int) -> None:
    one = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nX-Long: " + b"x" * 5_000 + b"\r\n\r\n"
    posted = b"POST /v1/nothing HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100000\r\n\r\n" + b"x" * 100_000
    answer = await exchanged(port, [one * 20, posted, one * 3, posted[:50_000], posted[50_000:], one, GET + b"\r\n"])
    assert (answer.count(b"HTTP/1.1 200"), answer.count(b"HTTP/1.1 404")) == (25, 2)


async def test_small_chunks_are_no_head(port: int) -> None:
    chunks = CHUNKED.removesuffix(b"0\r\n").replace(b"\r\n\r\n", b"\r\nConnection: close\r\n\r\n", 1)
    assert status_of(await exchanged(port, [chunks, *[b"1\r\n \r\n" * 5_000] * 10, b"0\r\n\r\n"])) == 415


async def test_a_head_that_does_not_come_ends_the_connection(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http_protocol, "HEAD_WITHIN_S", 0.2)
    late = await exchanged(port, [b"GET /healthz HTTP/1.1\r\nHos"])
    assert status_of(late) == 408
    assert b"urn:headsup:problem:headers-too-slow" in late
    assert await exchanged(port, []) == b""
    second = await exchanged(port, [b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n", b"GET /hea"])
    assert (second.count(b"HTTP/1.1 200"), second.count(b"HTTP/1.1 408")) == (1, 1)


async def test_what_is_no_request_is_a_problem(port: int) -> None:
    for nonsense in (b"\x16\x03\x01\x02\x00", b"GET / HTTP/1.1\r\nHo st: a\r\n\r\n"):
        answer = await exchanged(port, [nonsense + b"\r\n"])
        assert status_of(answer) == 400
        assert b"application/problem+json" in answer
    async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{port}", trust_env=False) as client:
        assert (await client.get("/healthz")).status_code == 200
