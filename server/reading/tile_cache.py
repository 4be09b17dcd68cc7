"""Encoded features in memory, by tile: what nearby queries are answered from. Bounded; pure but for its own state.

A feature is one plain tuple of numbers and bytes: the garbage collector stops looking at such, and with a million
objects that it looks at each of its rounds stopped the process for tens of milliseconds.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import OrderedDict
from collections.abc import Iterable
from operator import itemgetter
from typing import NamedTuple
from uuid import UUID

from contract.geometry import LatLon
from server.geometry.geodesy import LocalMetric, distance_m, local_metric, mercator

_TURN = 2 * math.pi
_ID_BYTES = 16
# What a cached feature takes besides its text: a tuple of five objects, a place in the list and in the dictionary.
_OVERHEAD_BYTES = 420


class Served(NamedTuple):
    """A live obstacle as it is served; `expires_at_us` counts from 1970, `mark` is its id and revision."""

    mark: bytes
    latitude_deg: float
    longitude_deg: float
    expires_at_us: int
    body: bytes


class TileChange(NamedTuple):
    """A line of a tile's event log: an obstacle's new value, or None when it is not served from this tile any more."""

    seq: int
    identifier: bytes
    served: Served | None


Entry = tuple[complex, int, bytes, bytes, float, float]
"""A feature in memory: its place by `mercator`, expiry, mark, text, latitude and longitude in degrees."""

Found = tuple[float, bytes, Entry]
"""A feature in a circle: its distance in metres (the local metric's, but for near ties: `in_order`), mark, entry."""


class Around(NamedTuple):
    """A circle, and how distances from its centre are measured."""

    centre: LatLon
    radius_m: float
    metric: LocalMetric


def around(centre: LatLon, radius_m: float) -> Around:
    """A circle of a few km at most."""
    return Around(centre, radius_m, local_metric(centre))


class TileFeatures:
    """The live obstacles of one tile, as of a version of the tile, from south to north."""

    def __init__(self, version: int, features: Iterable[Served]) -> None:
        self.version = version
        self.size_bytes = 0
        self._by_id: dict[bytes, Entry] = {}
        # From south to north, and how far north they are: numbers are compared faster than entries.
        self._entries: list[Entry] = []
        self._norths: list[float] = []
        # In the order in which they are read, so that they lie side by side in memory too.
        for feature in sorted(features, key=itemgetter(1)):
            self._add(feature)

    def apply(self, change: TileChange) -> None:
        """Take the next change of the tile."""
        self.version = change.seq
        self._drop(change.identifier)
        if change.served is not None:
            self._add(change.served)

    def about(self, circle: Around, now_us: int) -> list[Found]:
        """What has not expired and may lie within the circle, if not exactly: `in_order` decides.

        Some hundred features lie at a circle's latitudes: comparing them one by one takes less than NumPy's overhead.
        """
        if not self._entries:
            return []
        middle, scale_m, sine = circle.metric
        # Across the antimeridian the tile lies a turn away.
        turns = round((self._entries[0][0].real - middle.real) / _TURN)
        if turns:
            middle += turns * _TURN
        # The scale within the circle is nowhere less than this.
        farthest_m = circle.radius_m + circle.metric.error_m(circle.radius_m)
        reach = farthest_m / (scale_m - farthest_m)
        bend_m = scale_m * sine / 2
        first = bisect_left(self._norths, middle.imag - reach)
        last = bisect_right(self._norths, middle.imag + reach, first)
        # As `LocalMetric.distance_m` has it, without a call for each.
        return [
            (apart * (scale_m - bend_m * way.imag), entry[2], entry)
            for entry in self._entries[first:last]
            if (apart := abs(way := entry[0] - middle)) <= reach and entry[1] > now_us
        ]

    def _add(self, feature: Served) -> None:
        mark, latitude_deg, longitude_deg, expires_at_us, body = feature
        self._drop(mark[:_ID_BYTES])
        place = mercator(latitude_deg, longitude_deg)
        entry = self._by_id[mark[:_ID_BYTES]] = (place, expires_at_us, mark, body, latitude_deg, longitude_deg)
        index = bisect_left(self._norths, place.imag)
        self._norths.insert(index, place.imag)
        self._entries.insert(index, entry)
        self.size_bytes += _OVERHEAD_BYTES + len(body)

    def _drop(self, identifier: bytes) -> None:
        """Take a feature out, if it is there."""
        entry = self._by_id.pop(identifier, None)
        if entry is None:
            return
        self.size_bytes -= _OVERHEAD_BYTES + len(entry[3])
        index = self._entries.index(entry, bisect_left(self._norths, entry[0].imag))
        del self._norths[index], self._entries[index]


class TileCache:
    """Tiles by number, the least recently used forgotten beyond `limit_bytes`."""

    def __init__(self, limit_bytes: int) -> None:
        self._limit_bytes = limit_bytes
        self._tiles: OrderedDict[int, TileFeatures] = OrderedDict()
        self.size_bytes = 0

    def get(self, tile: int) -> TileFeatures | None:
        """A tile, or None when it is not cached."""
        found = self._tiles.get(tile)
        if found is not None:
            self._tiles.move_to_end(tile)
        return found

    def put(self, tile: int, features: TileFeatures) -> None:
        """Cache a tile."""
        self.forget(tile)
        self._tiles[tile] = features
        self._grown(features.size_bytes)

    def forget(self, tile: int) -> None:
        """Drop a tile."""
        if known := self._tiles.pop(tile, None):
            self.size_bytes -= known.size_bytes

    def resized(self, tile: int, before_bytes: int) -> None:
        """Account for a tile that was changed in place, if it is still cached."""
        if tile in self._tiles:
            self._grown(self._tiles[tile].size_bytes - before_bytes)

    def _grown(self, by_bytes: int) -> None:
        self.size_bytes += by_bytes
        # One tile is always kept, however large: the query at hand needs it.
        while self.size_bytes > self._limit_bytes and len(self._tiles) > 1:
            _, oldest = self._tiles.popitem(last=False)
            self.size_bytes -= oldest.size_bytes


def in_order(found: Iterable[Found], circle: Around) -> list[Found]:
    """Those within the radius by geodesic distance, then by id.

    The geodesic is only solved where the local metric cannot tell: at the edge, and between near ties.
    """
    ordered = sorted(found)
    error_m = circle.metric.error_m(circle.radius_m)
    while ordered and ordered[-1][0] > circle.radius_m + error_m:
        ordered.pop()
    if not ordered:
        return ordered
    # No two are closer to a tie than the farthest may be wrong.
    least_gap_m, before_m = 2 * error_m, -math.inf
    close: set[int] = set()
    for index, item in enumerate(ordered):
        if item[0] - before_m <= least_gap_m:
            close.update((index - 1, index))
        before_m = item[0]
    if before_m > circle.radius_m - error_m:
        close.update(index for index, item in enumerate(ordered) if item[0] > circle.radius_m - error_m)
    if not close:
        return ordered
    for index in close:
        _, mark, entry = ordered[index]
        ordered[index] = (_geodesic_m(entry, circle.centre), mark, entry)
    return [item for item in sorted(ordered) if item[0] <= circle.radius_m]


def identifier_of(entry: Entry) -> UUID:
    """The obstacle's id."""
    return UUID(bytes=entry[2][:_ID_BYTES])


def _geodesic_m(entry: Entry, centre: LatLon) -> float:
    return distance_m(centre, LatLon(latitude_deg=entry[4], longitude_deg=entry[5]))
