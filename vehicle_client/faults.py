"""Faults of the program in single frames: a drive that runs for a year outlives one, and nobody overlooks it."""

from __future__ import annotations

import logging

_LOG = logging.getLogger(__name__)

MOST_IN_A_ROW = 20
"""Two seconds of a LiDAR's sweeps: what fails for so long does not mend itself, and a process begun anew may."""


class Faults:
    """Counts them; the first of each kind is logged with its trace."""

    def __init__(self) -> None:
        self.total = 0
        self._in_a_row = 0
        self._kinds: set[tuple[str, int]] = set()

    def add(self, error: Exception) -> None:
        """Count a frame's fault; to be called where it was caught. Raises it after too many in a row."""
        self.total += 1
        self._in_a_row += 1
        if self._in_a_row >= MOST_IN_A_ROW:
            raise error
        kind = type(error).__name__, _line_of(error)
        if kind not in self._kinds:
            self._kinds.add(kind)
            _LOG.error("a frame failed and is left out: %r", error, exc_info=error)

    def end_row(self) -> None:
        """A frame went through."""
        self._in_a_row = 0


def _line_of(error: Exception) -> int:
    trace = error.__traceback__
    line = 0
    while trace is not None:
        line, trace = trace.tb_lineno, trace.tb_next
    return line
