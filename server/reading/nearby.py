"""Nearby queries from memory, as fresh as the database: no query answers what an earlier answered write has changed.

Each query joins the next version check: one `SELECT` of tile versions answers all queries that arrived before it was
sent. Tiles whose version rose get the changed rows from the event log; tiles that are not in memory are loaded.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

from contract.geometry import LatLon
from server.counters import NearbyCounts
from server.errors import UnavailableError
from server.geometry.quadkey import tiles
from server.life.policy import Life
from server.reading.tile_cache import Found, TileCache, TileFeatures, around, in_order
from server.reading.tile_reader import TileReader, Versions
from server.storage.database import Database

GREATEST_RADIUS_M = 2_000.0
"""Wider circles touch too many tiles: they are for SQL."""
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
# A check and the changes since take some milliseconds; hardly any street changes as often for seconds.
_MOST_CHECKS = 100


@dataclass(slots=True)
class _Check:
    """A version check that has not been sent yet, and the queries that wait for it."""

    tiles: set[int] = field(default_factory=set)
    waiting: list[asyncio.Future[Versions]] = field(default_factory=list)
    """One for each query: one that is cancelled does not cancel what the others wait for."""

    def answer(self, versions: Versions) -> None:
        """Tell all who wait."""
        for future in self.waiting:
            if not future.done():
                future.set_result(versions)

    def fail(self, error: Exception) -> None:
        """Tell all who wait that there is no answer."""
        for future in self.waiting:
            if not future.done():
                future.set_exception(error)


class Nearby:
    """What lies around a place, from the tiles that this process keeps in memory."""

    def __init__(self, database: Database, life: Life, limit_bytes: int) -> None:
        self._reader = TileReader(database, life)
        self._cache = TileCache(limit_bytes)
        self.counts = NearbyCounts()
        self._next: _Check | None = None
        self._checking: asyncio.Task[None] | None = None
        self._refreshing: dict[int, asyncio.Task[None]] = {}

    @property
    def size_bytes(self) -> int:
        """Memory of the tiles."""
        return self._cache.size_bytes

    async def within(self, centre: LatLon, radius_m: float, now: datetime) -> list[Found]:
        """Live obstacles within a geodesic radius of at most `GREATEST_RADIUS_M`, nearest first."""
        self.counts.queries += 1
        wanted = tiles(centre, radius_m)
        now_us = int((now - _EPOCH).total_seconds() * 1e6)
        fresh = await self._as_of_one_moment(wanted)
        circle = around(centre, radius_m)
        found: list[Found] = []
        for tile in fresh:
            found += tile.about(circle, now_us)
        return in_order(found, circle)

    async def _as_of_one_moment(self, wanted: Sequence[int]) -> list[TileFeatures]:
        """The tiles that were ever written to, all at the versions of one check.

        Were one of them later than another, an obstacle that moved between them would be told twice, or not at all.
        """
        for _ in range(_MOST_CHECKS):
            versions = await self._versions(wanted)
            # A tile without a row was never written to.
            here = [(tile, version) for tile in wanted if (version := versions.get(tile))]
            fresh = [self._in_memory(tile, version) or await self._fresh(tile, version) for tile, version in here]
            if len(here) == 1 or all(item.version == version for item, (_, version) in zip(fresh, here, strict=True)):
                return fresh
        raise UnavailableError("what is there changes faster than it can be read; ask again")

    def _versions(self, wanted: Iterable[int]) -> asyncio.Future[Versions]:
        """Versions of tiles, among others, read by a statement that is sent after this call."""
        if self._next is None:
            self._next = _Check()
        answer: asyncio.Future[Versions] = asyncio.get_running_loop().create_future()
        self._next.tiles.update(wanted)
        self._next.waiting.append(answer)
        if self._checking is None:
            self._checking = asyncio.create_task(self._check())
        return answer

    async def _check(self) -> None:
        try:
            while check := self._next:
                self._next = None
                self.counts.version_checks += 1
                try:
                    check.answer(await self._reader.versions(sorted(check.tiles)))
                except Exception as error:  # it belongs to the queries that wait, and the next may succeed
                    check.fail(error)
        finally:
            self._checking = None

    def _in_memory(self, tile: int, version: int) -> TileFeatures | None:
        """The tile, if it is here at least at a version."""
        known = self._cache.get(tile)
        if known is None or known.version < version:
            return None
        self.counts.tiles_fresh += 1
        return known

    async def _fresh(self, tile: int, version: int) -> TileFeatures:
        """The tile at least at a version; one task refreshes it for all who need it."""
        while (known := self._in_memory(tile, version)) is None:
            if tile not in self._refreshing:
                task = self._refreshing[tile] = asyncio.create_task(self._refresh(tile))
                task.add_done_callback(lambda _, done=tile: self._refreshing.pop(done))  # type: ignore[misc]  # mypy
            await asyncio.shield(self._refreshing[tile])
        return known

    async def _refresh(self, tile: int) -> None:
        known = self._cache.get(tile)
        changes = None if known is None else await self._reader.changes(tile, known.version)
        if known is None or changes is None:
            self._cache.put(tile, await self._reader.tile(tile))
            self.counts.tiles_loaded += 1
            return
        self.counts.tiles_changed += 1
        before_bytes = known.size_bytes
        for change in changes:
            known.apply(change)
        self._cache.resized(tile, before_bytes)
