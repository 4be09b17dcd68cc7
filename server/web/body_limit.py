"""Refuses a request body that is too large, too slow or compressed, before anything parses it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from contextlib import suppress

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.errors import BodyTooLargeError, BodyTooSlowError, ServiceError, UnsupportedMediaTypeError, problem_of

# A mebibyte at 350 kbit/s, the edge of mobile coverage; slower ones are sent in smaller batches.
_BODY_WITHIN_S = 30.0
# RFC 9112, 6: a request without either has no body.
_ANNOUNCING = frozenset({b"content-length", b"transfer-encoding"})
# A socket that is closed while bytes come in is reset, and the sender may never see why: RFC 9112, 9.6.
_LINGER_S, _LINGER_BYTES = 2.0, 16 << 20


class BodyLimit:
    """ASGI middleware: reads the body up to `limit_bytes`, then hands it on.

    413 beyond, at once when the length is announced: a sender that waits for `100 Continue` (RFC 9110, 10.1.1) gets
    it instead, and sends nothing. Whoever is refused loses the connection.
    """

    def __init__(self, app: ASGIApp, limit_bytes: int) -> None:
        self._app, self._limit_bytes = app, limit_bytes

    def __call__(self, scope: Scope, receive: Receive, send: Send) -> Awaitable[None]:
        """Serve one connection."""
        if scope["type"] != "http" or not _has_body(scope):
            return self._app(scope, receive, send)
        return self._limited(scope, receive, send)

    async def _limited(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = dict(scope["headers"])
        try:
            self._check(headers)
            messages = await self._read(receive)
        except ServiceError as error:
            lingers = b"expect" not in headers and not isinstance(error, BodyTooSlowError)
            await _refused(error, scope, receive, send, lingers)
        else:
            # A sender that was lost halfway, as vehicles are, is neither answered nor a fault of anybody's.
            if messages[-1]["type"] != "http.disconnect":
                await self._app(scope, _replayed(messages, receive), send)

    def _check(self, headers: dict[bytes, bytes]) -> None:
        length = headers.get(b"content-length", b"")
        # Beyond 18 digits it would not even be parsed.
        if length.isdigit() and (len(length) > 18 or int(length) > self._limit_bytes):
            raise self._too_large()
        if headers.get(b"content-encoding", b"identity").strip().lower() != b"identity":
            raise UnsupportedMediaTypeError("send the body as it is, without Content-Encoding")

    async def _read(self, receive: Receive) -> list[Message]:
        messages: list[Message] = []
        size_bytes = 0
        try:
            async with asyncio.timeout(_BODY_WITHIN_S):
                while not messages or messages[-1].get("more_body", False):
                    messages.append(await receive())
                    size_bytes += len(messages[-1].get("body", b""))
                    if size_bytes > self._limit_bytes:
                        raise self._too_large()
        except TimeoutError:
            raise BodyTooSlowError(f"the body did not arrive within {_BODY_WITHIN_S:.0f} s: send less") from None
        return messages

    def _too_large(self) -> BodyTooLargeError:
        return BodyTooLargeError(f"the body exceeds {self._limit_bytes} bytes: send fewer reports at once")


def _has_body(scope: Scope) -> bool:
    for name, _ in scope["headers"]:  # noqa: SIM110  # on the way of every request, and `any` takes twice as long
        if name in _ANNOUNCING:
            return True
    return False


async def _refused(error: ServiceError, scope: Scope, receive: Receive, send: Send, lingers: bool) -> None:
    """Answer at once, and close when the sender has heard it."""
    answer = problem_of(error)
    answer.headers["Connection"] = "close"

    async def unfinished(message: Message) -> None:
        is_body = message["type"] == "http.response.body"
        await send({**message, "more_body": True} if is_body else message)

    await answer(scope, receive, unfinished)
    if lingers:
        with suppress(TimeoutError):
            async with asyncio.timeout(_LINGER_S):
                await _discarded(receive)
    await send({"type": "http.response.body", "body": b"", "more_body": False})


async def _discarded(receive: Receive) -> None:
    size_bytes, more = 0, True
    while more and size_bytes < _LINGER_BYTES:
        message = await receive()
        size_bytes += len(message.get("body", b""))
        more = message.get("more_body", False)


def _replayed(messages: list[Message], receive: Receive) -> Receive:
    remaining = iter(messages)

    async def next_message() -> Message:
        for message in remaining:
            return message
        return await receive()

    return next_message
