"""Refuses a request body beyond a limit, or too slow to come, before anything parses it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.errors import BodyTooLargeError, BodyTooSlowError, ServiceError, problem_of

# A mebibyte at 350 kbit/s, the edge of mobile coverage; slower ones are sent in smaller batches.
_BODY_WITHIN_S = 30.0
# RFC 9112, 6: a request without either has no body.
_ANNOUNCING = frozenset({b"content-length", b"transfer-encoding"})


class BodyLimit:
    """ASGI middleware: reads the body up to `limit_bytes`, then hands it on; 413 beyond."""

    def __init__(self, app: ASGIApp, limit_bytes: int) -> None:
        self._app, self._limit_bytes = app, limit_bytes

    def __call__(self, scope: Scope, receive: Receive, send: Send) -> Awaitable[None]:
        """Serve one connection."""
        if scope["type"] != "http" or not _has_body(scope):
            return self._app(scope, receive, send)
        return self._limited(scope, receive, send)

    async def _limited(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            messages = await self._read(receive)
        except ServiceError as error:
            await problem_of(error)(scope, receive, send)
        else:
            await self._app(scope, _replayed(messages, receive), send)

    async def _read(self, receive: Receive) -> list[Message]:
        messages: list[Message] = []
        size_bytes = 0
        try:
            async with asyncio.timeout(_BODY_WITHIN_S):
                while not messages or messages[-1].get("more_body", False):
                    messages.append(await receive())
                    size_bytes += len(messages[-1].get("body", b""))
                    if size_bytes > self._limit_bytes:
                        raise BodyTooLargeError(
                            f"the body exceeds {self._limit_bytes} bytes: send fewer reports at once"
                        )
        except TimeoutError:
            raise BodyTooSlowError(f"the body did not arrive within {_BODY_WITHIN_S:.0f} s: send less") from None
        return messages


def _has_body(scope: Scope) -> bool:
    for name, _ in scope["headers"]:  # noqa: SIM110  # on the way of every request, and `any` takes twice as long
        if name in _ANNOUNCING:
            return True
    return False


def _replayed(messages: list[Message], receive: Receive) -> Receive:
    remaining = iter(messages)

    async def next_message() -> Message:
        for message in remaining:
            return message
        return await receive()

    return next_message
