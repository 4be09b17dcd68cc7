"""Obstacles in the order of their cells, so that what lies in ranges of cells is found by bisection."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Iterable, Iterator
from uuid import UUID

from server.quadkey import Ranges

Entry = tuple[int, UUID]
"""A cell, and an obstacle in it."""


class CellIndex:
    """Ids of obstacles by cell."""

    def __init__(self, entries: Iterable[Entry]) -> None:
        self._entries = sorted(entries)

    def within(self, ranges: Ranges) -> Iterator[UUID]:
        """Obstacles in ascending, disjoint ranges of cells."""
        for low, high in ranges:
            first = bisect_left(self._entries, (low,))
            last = bisect_left(self._entries, (high + 1,), lo=first)
            for _, identifier in self._entries[first:last]:
                yield identifier

    def add(self, entry: Entry) -> None:
        """Take an obstacle in."""
        insort(self._entries, entry)

    def remove(self, entry: Entry) -> None:
        """Let an obstacle go; raises `ValueError` when it is not there."""
        self._entries.remove(entry)
