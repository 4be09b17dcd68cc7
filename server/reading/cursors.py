"""Opaque cursors: where a page ended, and which query it belongs to. Pure."""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections.abc import Sequence
from datetime import datetime
from typing import Any
from uuid import UUID

_REFUSAL = "cursor: take it from the link `next` of the page before, and change nothing else but limit and f"
_GREATEST_INTEGER = 2**63 - 1


def cursor_of(scope: str, position: Sequence[datetime | UUID | float | int]) -> str:
    """A cursor of a position in the pages of `scope`, which names the query."""
    text = json.dumps([_fingerprint(scope), *map(_plain, position)], separators=(",", ":"))
    return base64.urlsafe_b64encode(text.encode()).decode().rstrip("=")


def position_of(cursor: str, scope: str, types: Sequence[type]) -> tuple[Any, ...]:
    """The position of a cursor, as values of `types` (datetime, UUID, float, int).

    Raises `ValueError` unless `cursor_of` made it for the same scope.
    """
    try:
        text = base64.b64decode(cursor.encode("ascii") + b"=" * (-len(cursor) % 4), altchars=b"-_", validate=True)
        fingerprint, *values = json.loads(text)
        position = tuple(_typed(value, kind) for value, kind in zip(values, types, strict=True))
    except (ValueError, TypeError, AttributeError, OverflowError, RecursionError):
        raise ValueError(_REFUSAL) from None
    if fingerprint != _fingerprint(scope):
        raise ValueError(_REFUSAL)
    return position


def _plain(value: datetime | UUID | float | int) -> str | float | int:
    if isinstance(value, datetime):
        return value.isoformat()
    return value.hex if isinstance(value, UUID) else value


def _typed(value: Any, kind: type) -> datetime | UUID | float | int:
    if kind is datetime:
        moment = datetime.fromisoformat(value)
        if moment.tzinfo is None:
            raise ValueError("a moment without an offset")
        return moment
    if kind is UUID:
        return UUID(hex=value)
    if kind is int:
        if type(value) is not int or abs(value) > _GREATEST_INTEGER:
            raise ValueError("not an integer of 64 bits")
        return value
    if not math.isfinite(float(value)):
        raise ValueError("not a finite number")
    return float(value)


def _fingerprint(scope: str) -> str:
    return hashlib.sha256(scope.encode()).hexdigest()[:12]
