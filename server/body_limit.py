"""Refuses a request body beyond a limit before anything parses it."""

from __future__ import annotations

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.errors import BodyTooLargeError, problem_of


class BodyLimit:
    """ASGI middleware: reads the body up to `limit_bytes`, then hands it on; 413 beyond."""

    def __init__(self, app: ASGIApp, limit_bytes: int) -> None:
        self._app, self._limit_bytes = app, limit_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        messages, size_bytes = [], 0
        while True:
            message = await receive()
            messages.append(message)
            size_bytes += len(message.get("body", b""))
            if size_bytes > self._limit_bytes:
                error = BodyTooLargeError(f"the body exceeds {self._limit_bytes} bytes: send fewer reports at once")
                await problem_of(error)(scope, receive, send)
                return
            if not message.get("more_body", False):
                break
        await self._app(scope, _replayed(messages, receive), send)


def _replayed(messages: list[Message], receive: Receive) -> Receive:
    remaining = iter(messages)

    async def next_message() -> Message:
        for message in remaining:
            return message
        return await receive()

    return next_message
