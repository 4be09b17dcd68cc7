"""Searches of small circles with filters, answered from memory as plain ones are; `Search` says the same by SQL."""

from __future__ import annotations

import asyncio
from datetime import datetime, timedelta
from itertools import islice

import numpy as np
from pydantic_core import from_json

from contract.geometry import Kind
from contract.observation import State
from server.geometry.quadkey import MERCATOR_LATITUDE_DEG
from server.life.decay import lasts_s
from server.life.policy import Life
from server.reading.around import Circle, nearest
from server.reading.nearby import GREATEST_RADIUS_M, Nearby
from server.reading.query import MAX_FEATURES, Filters
from server.reading.tile_cache import Entry, identifier_of
from server.reading.tile_reader import microseconds

# So many texts are read in 1 ms, in which a thread would hardly have begun.
_READ_AT_ONCE = 100


def is_remembered(circle: Circle, filters: Filters) -> bool:
    """Whether what is in memory is enough: nothing that was removed, and no more tiles than a street's."""
    if filters.states is not None and State.REMOVED in filters.states:
        return False
    return circle.radius_m <= GREATEST_RADIUS_M and abs(circle.centre.latitude_deg) <= MERCATOR_LATITUDE_DEG


async def around(nearby: Nearby, circle: Circle, filters: Filters, life: Life, now: datetime) -> list[Entry] | None:
    """All obstacles of a circle that `is_remembered`, by geodesic distance and id; None of a crowd, for SQL to page."""
    entries = [entry for _, _, entry in await nearby.within(circle.centre, circle.radius_m, now)]
    if len(entries) <= _READ_AT_ONCE:
        return _chosen(circle, entries, filters, life, now)
    return await asyncio.to_thread(_chosen, circle, entries, filters, life, now)


def is_wanted(entry: Entry, filters: Filters, life: Life, now: datetime) -> bool:
    """Whether a live obstacle passes the filters. Its text is our own, and read no further than they ask."""
    about = from_json(entry[3])["properties"]
    if filters.kinds and about["kind"] not in filters.kinds:
        return False
    if filters.states is not None and about["state"] not in filters.states:
        return False
    if filters.min_confidence > 0:
        least_s = lasts_s(filters.min_confidence, Kind(about["kind"]), life)
        if entry[1] < microseconds(now + timedelta(seconds=least_s)):
            return False
    if filters.seen_since is not None and datetime.fromisoformat(about["last_seen"]) < filters.seen_since:
        return False
    until = filters.first_seen_until
    return until is None or datetime.fromisoformat(about["first_seen"]) <= until


def _chosen(circle: Circle, entries: list[Entry], filters: Filters, life: Life, now: datetime) -> list[Entry] | None:
    if circle.ahead is not None:
        entries = _ahead(circle, entries)
    if len(entries) > MAX_FEATURES:
        return None
    return [entry for entry in entries if is_wanted(entry, filters, life, now)]


def _ahead(circle: Circle, entries: list[Entry]) -> list[Entry]:
    """What of it lies ahead, no more than one beyond a page: each takes a geodesic."""
    by_id = {identifier_of(entry): entry for entry in entries}
    places_deg = np.array([entry[4:] for entry in entries], dtype=np.float64).reshape(-1, 2)
    return [by_id[key.id] for key in islice(nearest(circle, list(by_id), places_deg, None), MAX_FEATURES + 1)]
