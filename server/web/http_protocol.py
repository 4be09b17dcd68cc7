"""uvicorn's two protocols with what they lack: bounds on a request's head, on its time, and on refused handshakes.

The parser is httptools as before; counting costs a request some two microseconds. h11 has such a bound, and is several
times slower.
"""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn._types import ASGISendEvent
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from server.errors import raw_problem

# As nginx has it: four buffers of 8 KiB, none of which a line may exceed. websockets takes lines of 8,192 bytes with
# their end, and 128 of them.
MAX_HEAD_BYTES, MAX_LINE_BYTES, MAX_FIELDS = 32_768, 8_000, 100
# A head is sent in one packet or a few; this is a lost one, twice repeated.
HEAD_WITHIN_S = 10.0
# Chunks of a single byte, the worst framing there is, take six bytes for each: the rest are trailers and extensions.
_FRAMING_PER_BYTE = 8
_FIELD_END_BYTES = len(b": \r\n")

_TOO_LARGE = raw_problem(
    431,
    "headers-too-large",
    f"the line and headers of a request are at most {MAX_HEAD_BYTES} bytes, {MAX_FIELDS} fields of {MAX_LINE_BYTES}",
)
_TOO_SLOW = raw_problem(408, "headers-too-slow", f"the headers did not arrive within {HEAD_WITHIN_S:.0f} s")
_NOT_HTTP = raw_problem(400, "bad-request", "this is no request of HTTP/1.1")


class _HeadTooLargeError(Exception):
    """Stops the parser."""


class BoundedHttp(HttpToolsProtocol):
    """HTTP/1.1 whose heads are limited: 431 for one that is too large, 408 for one that is too slow."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._is_in_head = self._is_refused = self._is_too_large = False
        self._beside_body_bytes = 0
        self._head_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """A new connection, from which a head must come."""
        super().connection_made(transport)
        self._await_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """The connection has ended."""
        self._head_has_come()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Bytes of a head or a body, at most some 256 KiB at once; those of a new head count from the next call on."""
        if self._is_refused:
            return
        self._beside_body_bytes += len(data)
        super().data_received(data)
        if self._beside_body_bytes > MAX_HEAD_BYTES and not self._is_refused:
            self._is_too_large = True
            self.send_400_response("")
        elif self._is_in_head and self._head_timer is None:
            self._await_head()

    def on_message_begin(self) -> None:
        """The first byte of a request."""
        super().on_message_begin()
        self._is_in_head, self._beside_body_bytes = True, 0

    def on_headers_complete(self) -> None:
        """The end of a head: its exact size is known."""
        self._is_in_head = False
        self._head_has_come()
        self._must_be_small()
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """A part of the body, which has its own limit, with the framing that it may need."""
        self._beside_body_bytes -= (1 + _FRAMING_PER_BYTE) * len(body)
        super().on_body(body)

    def on_message_complete(self) -> None:
        """The last byte of a request."""
        self._beside_body_bytes = 0
        super().on_message_complete()

    def send_400_response(self, msg: str) -> None:
        """Refuse what the parser could not take, and close."""
        self._is_refused = True
        self._head_has_come()
        self.transport.write(_TOO_LARGE if self._is_too_large else _NOT_HTTP)
        self.transport.close()

    def _must_be_small(self) -> None:
        sizes = [len(name) + len(value) + _FIELD_END_BYTES for name, value in self.headers]
        sizes.append(len(self.url))
        if sum(sizes) > MAX_HEAD_BYTES or max(sizes) > MAX_LINE_BYTES or len(sizes) > MAX_FIELDS + 1:
            self._is_too_large = True
            raise _HeadTooLargeError

    def _await_head(self) -> None:
        self._head_timer = self.loop.call_later(HEAD_WITHIN_S, self._head_is_late)

    def _head_has_come(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None

    def _head_is_late(self) -> None:
        self._head_timer = None
        if self.cycle is not None and not self.cycle.response_complete:
            # It was sent behind a request whose answer must not be cut off.
            self._await_head()
            return
        self._is_refused = True
        if self._is_in_head:
            self.transport.write(_TOO_SLOW)
        self.transport.close()


class QuietWebSocket(WebSocketsSansIOProtocol):
    """A WebSocket whose refused handshake is an ordinary answer, and no error in the log."""

    async def send(self, message: ASGISendEvent) -> None:
        """Send what the application says; the last part of a refusal completes the handshake."""
        await super().send(message)
        if message["type"] == "websocket.http.response.body" and self.close_sent:
            self.handshake_complete = True
