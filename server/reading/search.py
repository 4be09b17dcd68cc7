"""The SQL of searching readers: a page of a circle by distance, of a box by id. No OFFSET, no count unless asked."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from itertools import islice
from uuid import UUID

import numpy as np
from sqlalchemy import ColumnElement, Row, and_, func, or_, select, tuple_
from sqlalchemy.ext.asyncio import AsyncConnection

from contract.geometry import Kind
from contract.observation import State
from contract.obstacle import ObstacleFeature
from server.geometry.bounds import Bounds
from server.geometry.quadkey import CELL_ZOOM, Ranges, cover
from server.life.decay import lasts_s
from server.life.identity import shard_of_id
from server.life.policy import Life
from server.reading.around import Circle, Key, nearest
from server.reading.query import Filters
from server.storage import served, tables
from server.storage.served import SERVED

_TABLE = tables.obstacle
# Below this a circle is a few pages of the index, whatever it holds.
_LEAST_TRIED_M = 300.0
# A tile of zoom 9, 78 km wide at the equator: what it holds is sorted faster than a whole table is walked through.
_NARROW_CELLS = 4 ** (CELL_ZOOM - 9)


@dataclass(frozen=True, slots=True)
class Page:
    """Obstacles in order, and the last one's key when more follow."""

    features: tuple[ObstacleFeature, ...]
    more_behind: Key | None = None


class Search:
    """Searches within one read transaction; `now` decides what has expired and how far confidence has decayed."""

    def __init__(self, connection: AsyncConnection, life: Life, now: datetime) -> None:
        self._connection, self._life, self._now = connection, life, now

    async def around(self, circle: Circle, filters: Filters, after: Key | None, limit: int) -> Page:
        """A page of a circle by distance and id. Places are read first, whole obstacles only of the page."""
        keys: list[Key] = []
        for radius_m in _widening_m(circle.radius_m, after):
            keys = await self._keys(replace(circle, radius_m=radius_m), filters, after, limit + 1)
            if len(keys) > limit:
                break
        obstacles = await self._whole([key.id for key in keys[:limit]])
        return Page(obstacles, keys[limit - 1] if len(keys) > limit else None)

    async def inside(self, bounds: Bounds, filters: Filters, after: Key | None, limit: int) -> Page:
        """A page of a box by id: by the shard in it, then the whole id, which is the primary key's order."""
        ranges = bounds.cover()
        shard: ColumnElement[int] = _TABLE.c.shard
        if sum(high - low + 1 for low, high in ranges) <= _NARROW_CELLS:
            # As an expression it cannot tempt the planner to walk through the primary key instead of the cells.
            shard = shard + 0
        query = select(*SERVED).where(_within(bounds, ranges), *self._conditions(filters))
        if after is not None:
            query = query.where(tuple_(shard, _TABLE.c.id) > (shard_of_id(after.id), after.id))
        query = query.order_by(shard, _TABLE.c.id).limit(limit + 1)
        found = await served.read(self._connection, query, self._life)
        return Page(found[:limit], Key(0.0, found[limit - 1].id) if len(found) > limit else None)

    async def count(self, bounds: Bounds, filters: Filters) -> int:
        """How many obstacles all pages of a box hold."""
        query = (
            select(func.count()).select_from(_TABLE).where(_within(bounds, bounds.cover()), *self._conditions(filters))
        )
        return int((await self._connection.execute(query)).scalar_one())

    async def _keys(self, circle: Circle, filters: Filters, after: Key | None, limit: int) -> list[Key]:
        inside = and_(_in_cells(cover(circle.centre, circle.radius_m)), *self._conditions(filters))
        query = select(_TABLE.c.id, _TABLE.c.latitude_deg, _TABLE.c.longitude_deg).where(inside).order_by(_TABLE.c.id)
        found = (await self._connection.execute(query)).all()
        # In a thread: thousands of geodesics must not hold up those who ask for what is near.
        return await asyncio.to_thread(_nearest, circle, found, after, limit)

    async def _whole(self, identifiers: Sequence[UUID]) -> tuple[ObstacleFeature, ...]:
        if not identifiers:
            return ()
        shards = sorted(set(map(shard_of_id, identifiers)))
        query = select(*SERVED).where(_TABLE.c.shard.in_(shards), _TABLE.c.id.in_(identifiers))
        found = {item.id: item for item in await served.read(self._connection, query, self._life)}
        return tuple(found[item] for item in identifiers if item in found)

    def _conditions(self, filters: Filters) -> list[ColumnElement[bool]]:
        conditions = [self._in_state(filters.states)]
        if filters.kinds:
            conditions.append(_TABLE.c.kind.in_(sorted(kind.value for kind in filters.kinds)))
        if filters.min_confidence > 0:
            conditions.append(self._is_sure_enough(filters.min_confidence))
        if filters.seen_since is not None:
            conditions.append(_TABLE.c.last_seen >= filters.seen_since)
        if filters.first_seen_until is not None:
            conditions.append(_TABLE.c.first_seen <= filters.first_seen_until)
        return conditions

    def _in_state(self, states: frozenset[State] | None) -> ColumnElement[bool]:
        if states is None:
            return and_(_TABLE.c.state != State.REMOVED.value, _TABLE.c.expires_at > self._now)
        live = sorted(state.value for state in states - {State.REMOVED})
        is_live = and_(_TABLE.c.state.in_(live), _TABLE.c.expires_at > self._now)
        return or_(is_live, _TABLE.c.state == State.REMOVED.value) if State.REMOVED in states else is_live

    def _is_sure_enough(self, confidence: float) -> ColumnElement[bool]:
        """Decayed confidence as a moment."""
        return or_(*(self._lasts(kind, lasts_s(confidence, kind, self._life)) for kind in Kind))

    def _lasts(self, kind: Kind, seconds: float) -> ColumnElement[bool]:
        return and_(_TABLE.c.kind == kind.value, _TABLE.c.expires_at >= self._now + timedelta(seconds=seconds))


def _nearest(circle: Circle, found: Sequence[Row[UUID, float, float]], after: Key | None, limit: int) -> list[Key]:
    places_deg = np.array([(row[1], row[2]) for row in found], dtype=np.float64).reshape(-1, 2)
    return list(islice(nearest(circle, [row[0] for row in found], places_deg, after), limit))


def _widening_m(radius_m: float, after: Key | None) -> Iterator[float]:
    """Radii to try until the page is full, each of 16 times the area, so that the last one costs nearly all."""
    for share in (64, 16, 4):
        tried_m = radius_m / share
        if tried_m >= _LEAST_TRIED_M and (after is None or tried_m > after.distance_m):
            yield tried_m
    yield radius_m


def _within(bounds: Bounds, ranges: Ranges) -> ColumnElement[bool]:
    longitude = or_(*(_TABLE.c.longitude_deg.between(west, east) for west, east in bounds.longitude_spans))
    conditions = [
        _in_cells(ranges),
        _TABLE.c.latitude_deg.between(bounds.south_deg, bounds.north_deg),
        longitude,
    ]
    if math.isfinite(bounds.lowest_m):
        conditions.append(_TABLE.c.altitude_m >= bounds.lowest_m)
    if math.isfinite(bounds.highest_m):
        conditions.append(_TABLE.c.altitude_m <= bounds.highest_m)
    return and_(*conditions)


def _in_cells(ranges: Ranges) -> ColumnElement[bool]:
    return or_(*(_TABLE.c.cell.between(low, high) for low, high in ranges))
