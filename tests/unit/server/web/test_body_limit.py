"""Bodies: whole, too large, too slow, absent."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from starlette.types import Message, Receive, Scope, Send

from server.web import body_limit
from server.web.body_limit import BodyLimit

LIMIT_BYTES = 64
Answer = tuple[int, str | None, bytes]


async def echo(scope: Scope, receive: Receive, send: Send) -> None:
    """Answers with the body, if one was announced."""
    body, more = b"", bool(scope["headers"])
    while more:
        message = await receive()
        body, more = body + message.get("body", b""), message.get("more_body", False)
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": body})


async def answered(chunks: list[bytes], header: bytes = b"transfer-encoding", then: float = 0.0) -> Answer:
    """Status, type of the problem and body; `then` is the pause in seconds before each chunk."""
    incoming = [{"type": "http.request", "body": chunk, "more_body": True} for chunk in chunks]
    incoming.append({"type": "http.request", "body": b"", "more_body": False})
    sent: list[Message] = []

    async def receive() -> Message:
        await asyncio.sleep(then)
        return incoming.pop(0)

    async def send(message: Message) -> None:
        sent.append(message)

    value = b"%d" % sum(map(len, chunks)) if header == b"content-length" else b"chunked"
    scope: dict[str, Any] = {"type": "http", "headers": [(header, value)] if header else []}
    await BodyLimit(echo, LIMIT_BYTES)(scope, receive, send)
    status, body = sent[0]["status"], b"".join(message["body"] for message in sent[1:])
    return status, None if status == 200 else json.loads(body)["type"].rpartition(":")[2], body


@given(st.lists(st.binary(max_size=20), max_size=8), st.sampled_from([b"content-length", b"transfer-encoding"]))
def test_a_body_comes_through_whole_or_is_refused_by_its_size(chunks: list[bytes], header: bytes) -> None:
    whole = b"".join(chunks)
    status, problem, body = asyncio.run(answered(chunks, header))
    if len(whole) <= LIMIT_BYTES:
        assert (status, body) == (200, whole)
    else:
        assert (status, problem) == (413, "body-too-large")


async def test_a_body_that_does_not_arrive_in_time_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(body_limit, "_BODY_WITHIN_S", 0.05)
    status, problem, _ = await answered([b"slow"], then=60)
    assert (status, problem) == (408, "body-too-slow")


async def test_a_request_that_announces_no_body_is_not_waited_for() -> None:
    assert await answered([], header=b"", then=60) == (200, None, b"")
