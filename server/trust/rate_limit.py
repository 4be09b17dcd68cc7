"""Token buckets by name, bounded in number. Pure but for its own state; the time is a parameter."""

from __future__ import annotations

from collections import OrderedDict

# A bucket takes some 200 bytes. Who is forgotten begins with a full one.
_MOST_BUCKETS = 100_000
# Sums of steps, and of clocks that count from the machine's start.
_ROUNDING_S = 1e-6


class RateLimit:
    """At most `burst` at once and `rate_hz` in the long run, for each name.

    A bucket is one number, the moment when it is full again (the generic cell rate algorithm, ITU-T I.371, annex A):
    what is taken moves it on, and it must not lie further ahead than a whole burst takes to refill.
    """

    def __init__(self, rate_hz: float, burst: float, most: int = _MOST_BUCKETS) -> None:
        self._step_s, self._depth_s, self._most = 1 / rate_hz, burst / rate_hz, most
        self._full_at_s: OrderedDict[str, float] = OrderedDict()

    def __len__(self) -> int:
        return len(self._full_at_s)

    def take(self, name: str, now_s: float, cost: float = 1.0) -> float:
        """Take `cost` if it is there; the seconds to wait when it is not, else 0.

        `now_s` is of any clock that never goes back.
        """
        full_at_s = max(self._full_at_s.get(name, now_s), now_s) + cost * self._step_s
        wait_s = full_at_s - now_s - self._depth_s
        if wait_s > _ROUNDING_S:
            return wait_s
        self._full_at_s[name] = full_at_s
        self._full_at_s.move_to_end(name)
        if len(self._full_at_s) > self._most:
            self._full_at_s.popitem(last=False)
        return 0.0
