"""Headers that tell browsers what an answer may do: nothing but be read.

Strict-Transport-Security is the proxy's to send, which ends TLS and knows whether all of the host has it.
"""

from __future__ import annotations

RawHeaders = tuple[tuple[bytes, bytes], ...]

_ALWAYS: RawHeaders = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
)


def _with_policy(policy: str) -> RawHeaders:
    return (*_ALWAYS, (b"content-security-policy", policy.encode()))


DATA = _with_policy("default-src 'none'; frame-ancestors 'none'")
"""For JSON, GeoJSON and XML, which load nothing and are framed by nobody."""

# FastAPI's viewers are a page with a script in it, and load theirs from one host.
_VIEWER = _with_policy(
    "default-src 'none'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'; connect-src 'self'; "
    "script-src https://cdn.jsdelivr.net 'unsafe-inline'; style-src https://cdn.jsdelivr.net 'unsafe-inline' "
    "https://fonts.googleapis.com; font-src https://fonts.gstatic.com; worker-src blob:; "
    "img-src https://fastapi.tiangolo.com https://cdn.redoc.ly data:"
)
_PAGES = {"/docs": _VIEWER, "/redoc": _VIEWER}


def headers_for(path: str) -> RawHeaders:
    """The headers of an answer at `path`."""
    return _PAGES.get(path, DATA)
