"""How a drive is told to end: the first Ctrl-C or SIGTERM ends it in order, a second one at once."""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType, TracebackType

NUMBERS = (signal.SIGINT, signal.SIGTERM)


class EndedEarly(KeyboardInterrupt):
    """The signal came before anybody had said how to end in order; nothing that catches faults catches this."""


class Ending:
    """Hears the signals within its block. Until `calls` has said what to do, they raise `EndedEarly`."""

    def __init__(self) -> None:
        self._stop: Callable[[], None] | None = None

    def __enter__(self) -> Ending:
        self._before = {number: signal.signal(number, self._end) for number in NUMBERS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def calls(self, stop: Callable[[], None]) -> None:
        """From now on the signal calls this, which must be harmless in a signal's handler."""
        self._stop = stop

    def _end(self, number: int, frame: FrameType | None) -> None:
        # Whichever of them comes second: who has pressed Ctrl-C in vain sends SIGTERM.
        for either in NUMBERS:
            signal.signal(either, signal.default_int_handler)
        if self._stop is None:
            raise EndedEarly
        self._stop()
