"""The name that a vehicle's reports carry, which changes so that they do not add up to a drive."""

from __future__ import annotations

from collections.abc import Callable
from secrets import token_hex

ROTATED_S = 600.0
"""As long as the server takes what one vehicle says for one pass: less would hide nothing more."""

PAUSE_S = 120.0
"""Longer than a red light: whoever stands this long may have arrived, and what follows is another drive."""


class Pseudonyms:
    """Names in turn. `draw` makes one: from the system's secrets in a car, from a seed in a test.

    Only for vehicles with a key of their own: without keys the server takes the name for the vehicle.
    """

    def __init__(self, draw: Callable[[], str] = lambda: f"v-{token_hex(8)}") -> None:
        self._draw = draw
        self._name: str | None = None
        self._since_s = self._last_s = 0.0

    def at(self, stamp_s: float) -> str:
        """The name at a moment (Unix time): another one after ten minutes, a pause, or a clock that went back."""
        is_old = not 0 <= stamp_s - self._since_s < ROTATED_S
        is_rested = not 0 <= stamp_s - self._last_s < PAUSE_S
        if self._name is None or is_old or is_rested:
            self._name, self._since_s = self._draw(), stamp_s
        self._last_s = stamp_s
        return self._name
