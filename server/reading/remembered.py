"""Searches of small areas with filters, answered from memory as plain circles are; `Search` says the same by SQL."""

from __future__ import annotations

import asyncio
import math
from datetime import datetime, timedelta
from itertools import islice
from uuid import UUID

import numpy as np
from pydantic_core import from_json

from contract.geometry import Kind, LatLon
from contract.observation import State
from server.geometry.bounds import Bounds
from server.geometry.geodesy import distance_m
from server.geometry.quadkey import MERCATOR_LATITUDE_DEG
from server.life.decay import lasts_s
from server.life.identity import shard_of_id
from server.life.policy import Life
from server.reading.around import Circle, nearest
from server.reading.nearby import GREATEST_RADIUS_M, Nearby
from server.reading.query import MAX_FEATURES, Filters
from server.reading.tile_cache import Entry, identifier_of
from server.reading.tile_reader import microseconds

# So many texts are read in 1 ms, in which a thread would hardly have begun.
_READ_AT_ONCE = 100
# Up to 85 degrees a box that is wider does not fit into the circle.
_WIDEST_DEG = 0.5
_BEND, _LEAST_BEND_M = 1.01, 0.1


def circle_of(area: Circle | Bounds, filters: Filters) -> Circle | None:
    """The circle whose obstacles are in memory and hold the area's; None when something of it is not in memory."""
    if filters.states is not None and State.REMOVED in filters.states:
        return None
    circle = area if isinstance(area, Circle) else _circle_about(area)
    if circle is None or circle.radius_m > GREATEST_RADIUS_M:
        return None
    return circle if abs(circle.centre.latitude_deg) <= MERCATOR_LATITUDE_DEG else None


async def found_in(
    nearby: Nearby, area: Circle | Bounds, circle: Circle, filters: Filters, life: Life, now: datetime
) -> list[Entry] | None:
    """All obstacles of an area within `circle_of` it, in order as by SQL; None of a crowd, for SQL to page."""
    entries = [entry for _, _, entry in await nearby.within(circle.centre, circle.radius_m, now)]
    if len(entries) <= _READ_AT_ONCE:
        return _chosen(area, entries, filters, life, now)
    return await asyncio.to_thread(_chosen, area, entries, filters, life, now)


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


def _circle_about(bounds: Bounds) -> Circle | None:
    width_deg = bounds.east_deg - bounds.west_deg + (360.0 if bounds.west_deg > bounds.east_deg else 0.0)
    if width_deg > _WIDEST_DEG or math.isfinite(bounds.lowest_m) or math.isfinite(bounds.highest_m):
        return None
    middle_deg = (bounds.west_deg + width_deg / 2 + 180.0) % 360.0 - 180.0
    centre = LatLon(latitude_deg=(bounds.south_deg + bounds.north_deg) / 2, longitude_deg=middle_deg)
    corners = [
        LatLon(latitude_deg=item, longitude_deg=bounds.east_deg) for item in (bounds.south_deg, bounds.north_deg)
    ]
    farthest_m = max(distance_m(centre, corner) for corner in corners)
    # A parallel bends away from between its corners, by less than this where it is as short as here.
    return Circle(centre, _BEND * farthest_m + _LEAST_BEND_M)


def _chosen(
    area: Circle | Bounds, entries: list[Entry], filters: Filters, life: Life, now: datetime
) -> list[Entry] | None:
    if isinstance(area, Bounds):
        entries = [entry for entry in entries if area.holds(entry[4], entry[5])]
        entries.sort(key=_by_id)
    elif area.ahead is not None:
        entries = _ahead(area, entries)
    if len(entries) > MAX_FEATURES:
        return None
    return [entry for entry in entries if is_wanted(entry, filters, life, now)]


def _by_id(entry: Entry) -> tuple[int, UUID]:
    identifier = identifier_of(entry)
    return shard_of_id(identifier), identifier


def _ahead(circle: Circle, entries: list[Entry]) -> list[Entry]:
    """What of it lies ahead, no more than one beyond a page: each takes a geodesic."""
    by_id = {identifier_of(entry): entry for entry in entries}
    places_deg = np.array([entry[4:] for entry in entries], dtype=np.float64).reshape(-1, 2)
    return [by_id[key.id] for key in islice(nearest(circle, list(by_id), places_deg, None), MAX_FEATURES + 1)]
