"""What is known of the request at hand: its id, its trace (W3C Trace Context), and whose key it carries."""

from __future__ import annotations

import itertools
import re
import secrets
from collections.abc import Iterable
from contextvars import ContextVar
from dataclasses import dataclass

# What a log can take as it is; 64 characters hold a UUID, a trace or a name with a number.
_REQUEST_ID = re.compile(rb"[A-Za-z0-9._:-]{1,64}")
# https://www.w3.org/TR/trace-context/, 3.2: version 00, and later ones that begin alike.
_TRACEPARENT = re.compile(rb"(?!ff)[0-9a-f]{2}-(?!0{32})([0-9a-f]{32})-(?!0{16})[0-9a-f]{16}-([0-9a-f]{2})(?:-.*)?")
_FORWARDED = frozenset(
    {b"x-forwarded-for", b"x-forwarded-host", b"x-forwarded-proto", b"x-real-ip", b"forwarded", b"via"}
)
_READ = _FORWARDED | {b"x-request-id", b"traceparent"}


@dataclass(slots=True)
class RequestContext:
    """A request's names. `key_id` is set as soon as the caller is known."""

    request_id: str
    """What the caller named it, else its trace, else made here."""
    trace_id: str | None = None
    traceparent: str | None = None
    """This server's place in the trace, for whoever is asked next, and for the answer."""
    is_forwarded: bool = False
    """Whether a proxy says that it passed the request on."""
    key_id: str | None = None


CURRENT: ContextVar[RequestContext | None] = ContextVar("headsup_request", default=None)


class RequestNames:
    """Makes the contexts of one process; ids are a random name of the process and a number, which costs nothing."""

    def __init__(self) -> None:
        self._process = secrets.token_hex(6)
        self._number = itertools.count(1)

    def context(self, headers: Iterable[tuple[bytes, bytes]]) -> RequestContext:
        """The context of a request with these headers, whose names are in lower case (as ASGI has them)."""
        given = traced = None
        is_forwarded = False
        for name, value in headers:
            if name not in _READ:
                continue
            if name == b"x-request-id":
                given = _REQUEST_ID.fullmatch(value)
            elif name == b"traceparent":
                traced = _TRACEPARENT.fullmatch(value)
            else:
                is_forwarded = True
        if given is None and traced is None:
            return RequestContext(f"{self._process}-{next(self._number):x}", None, None, is_forwarded)
        return _named(given, traced, is_forwarded)


def _named(given: re.Match[bytes] | None, traced: re.Match[bytes] | None, is_forwarded: bool) -> RequestContext:
    trace_id = traceparent = None
    if traced is not None:
        trace_id = traced.group(1).decode()
        traceparent = f"00-{trace_id}-{secrets.token_hex(8)}-{traced.group(2).decode()}"
    request_id = given.group().decode() if given is not None else trace_id
    assert request_id is not None  # noqa: S101  # called with one of both
    return RequestContext(request_id, trace_id, traceparent, is_forwarded)


def note_key(key_id: str) -> None:
    """Remember whose key the request carries."""
    context = CURRENT.get()
    if context is not None:
        context.key_id = key_id
