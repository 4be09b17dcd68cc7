"""Obstacles in the order of their cells, so that what lies in ranges of cells is found by bisection."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from uuid import UUID

from server.geometry.quadkey import Ranges


class CellIndex:
    """Ids of obstacles by cell."""

    def __init__(self, entries: Iterable[tuple[int, UUID]]) -> None:
        ordered = sorted(entries)
        # Apart, since numbers are compared faster than pairs.
        self._cells = [cell for cell, _ in ordered]
        self._ids = [identifier for _, identifier in ordered]

    def within(self, ranges: Ranges) -> list[UUID]:
        """Obstacles in ascending, disjoint ranges of cells."""
        if not ranges:
            return []
        cells = self._cells
        first = bisect_left(cells, ranges[0][0])
        end = bisect_right(cells, ranges[-1][1], first)
        found: list[UUID] = []
        for low, high in ranges:
            first = bisect_left(cells, low, first, end)
            if first == end:
                break
            last = bisect_right(cells, high, first, end)
            found += self._ids[first:last]
            first = last
        return found

    def add(self, cell: int, identifier: UUID) -> None:
        """Take an obstacle in."""
        index = bisect_left(self._cells, cell)
        self._cells.insert(index, cell)
        self._ids.insert(index, identifier)

    def remove(self, cell: int, identifier: UUID) -> None:
        """Let an obstacle go; raises `ValueError` when it is not there."""
        index = self._ids.index(identifier, bisect_left(self._cells, cell))
        del self._cells[index], self._ids[index]
