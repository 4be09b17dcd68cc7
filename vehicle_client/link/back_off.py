"""How long to wait before trying again. Pure: the jitter and the time are values."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime

FIRST_S = 1.0
"""A server that restarts is back within seconds, and a lost packet at once."""

GREATEST_S = 60.0
"""A car that comes out of a tunnel or a dead spot is heard again within a minute."""

GREATEST_WAIT_S = 3_600.0
"""What a server may ask for at most; a faulty proxy must not silence a car for a day."""


def delay_s(attempt: int, jitter: float, server_wait_s: float | None = None) -> float:
    """Seconds to wait after the `attempt`-th failure in a row (from 1).

    Doubles from 1 s to 60 s; `jitter` in [0, 1) takes off up to half, so that cars that lost the server together come
    back one by one. Never less than what the server asked for, up to an hour of it.
    """
    doubled_s = min(FIRST_S * 2.0 ** min(attempt - 1, 32), GREATEST_S)
    asked_s = min(server_wait_s or 0.0, GREATEST_WAIT_S)
    return max(doubled_s * (1 - jitter / 2), asked_s * (1 + jitter / 10))


def retry_after_s(header: str | None, now: datetime) -> float | None:
    """Seconds of a `Retry-After` (RFC 9110, 10.2.3: a number or a date); None when there is none that can be read."""
    text = (header or "").strip()
    if not text:
        return None
    if text.isascii() and text.isdigit():
        # More digits than any wait has.
        return float(text) if len(text) < 10 else math.inf
    try:
        moment = parsedate_to_datetime(text)
    except ValueError:
        return None
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    return max(0.0, (moment - now).total_seconds())
