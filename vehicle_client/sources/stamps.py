"""Stamps that only rise: which sweeps of a clock that errs can be used."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

MOST_GAP_S = 60.0
"""A longer step forward is a recording that was paused, a clock that was set, or one corrupt stamp."""

AGREEING = 3
"""Sweeps in a row that go on after such a step before it is believed: a single corrupt one would hide all others."""

YEAR_2100_S = 4_102_444_800.0


@dataclass(slots=True)
class StampGate:
    """Lets stamps through that rise: none earlier than one before it, and no far step that the next do not confirm."""

    last_s: float = field(default=-math.inf, init=False)
    refused_in_a_row: int = field(default=0, init=False)
    _after_step_s: float = field(default=-math.inf, init=False)
    _agreeing: int = field(default=0, init=False)

    def refusal(self, stamp_s: float) -> str | None:
        """Why a sweep of this stamp (Unix time) cannot follow; None if it can, and is then the last."""
        reason = self._reason(stamp_s)
        if reason is None:
            self.last_s = stamp_s
            self._after_step_s, self._agreeing, self.refused_in_a_row = -math.inf, 0, 0
        else:
            self.refused_in_a_row += 1
        return reason

    def _reason(self, stamp_s: float) -> str | None:
        if not 0 <= stamp_s < YEAR_2100_S:
            return f"its stamp {stamp_s} is no time"
        if stamp_s <= self.last_s:
            return f"its stamp {stamp_s:.3f} is not after {self.last_s:.3f}, that of the sweep before"
        if self.last_s == -math.inf or stamp_s - self.last_s <= MOST_GAP_S:
            return None
        goes_on = 0 < stamp_s - self._after_step_s <= MOST_GAP_S
        self._agreeing = self._agreeing + 1 if goes_on else 1
        self._after_step_s = stamp_s
        if self._agreeing >= AGREEING:
            return None
        return f"its stamp {stamp_s:.3f} lies {stamp_s - self.last_s:.0f} s after that of the sweep before"
