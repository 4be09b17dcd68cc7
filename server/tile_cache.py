"""Encoded features in memory, by tile: what nearby queries are answered from. Bounded; pure but for its own state.

A tile is a few columns, not an object for each feature: the garbage collector looks at every object that can hold
others, and with a million features each of its rounds stopped the process for tens of milliseconds.
"""

from __future__ import annotations

from array import array
from collections import OrderedDict
from collections.abc import Iterable, MutableSequence
from dataclasses import dataclass
from itertools import pairwise
from operator import itemgetter
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from contract.geometry import LatLon
from server.geodesy import FloatArray, distance_m, metres_per_degree

T = TypeVar("T")

# The local metric differs from the geodesic by less than 0.8e-9 of the distance squared, up to 85 degrees and 4 km.
_ERROR_PER_M2 = 2e-9
# Up to 85 degrees a circle of 2 km and a tile reach less far.
_NEAR_THE_ANTIMERIDIAN_DEG = 179.0
# Differences of degrees in floats, as metres.
_LEAST_ERROR_M = 1e-7
_ID_BYTES = 16
# What a cached feature takes besides its text: two objects, an entry in each column and in the dictionary.
_OVERHEAD_BYTES = 300


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


Found = tuple[float, bytes, bytes, float, float]
"""A feature within a circle: its distance in metres (the local metric's, but for near ties: `in_order`), mark, encoded
text, latitude and longitude in degrees. A plain tuple, since making named ones took a fifth of a query.
"""


@dataclass(frozen=True, slots=True)
class _Columns:
    """The numbers of a tile as arrays, for searching."""

    latitude_deg: FloatArray
    longitude_deg: FloatArray
    expires_at_us: NDArray[np.int64]
    soonest_us: int


class TileFeatures:
    """The live obstacles of one tile, as of a version of the tile."""

    def __init__(self, version: int, features: Iterable[Served]) -> None:
        self.version = version
        self.size_bytes = 0
        self._index: dict[bytes, int] = {}
        self._marks: list[bytes] = []
        self._bodies: list[bytes] = []
        self._latitude_deg, self._longitude_deg, self._expires_at_us = array("d"), array("d"), array("q")
        self._columns: _Columns | None = None
        for feature in features:
            self._add(feature)

    def apply(self, change: TileChange) -> None:
        """Take the next change of the tile."""
        self._columns = None
        self.version = change.seq
        self._drop(change.identifier)
        if change.served is not None:
            self._add(change.served)

    def within(self, centre: LatLon, radius_m: float, now_us: int) -> list[Found]:
        """Features within a geodesic radius (a few km at most) that have not expired."""
        if not self._marks:
            return []
        columns = self._columns = self._columns or self._as_arrays()
        north_deg = columns.latitude_deg - centre.latitude_deg
        east_deg = columns.longitude_deg - centre.longitude_deg
        if abs(centre.longitude_deg) > _NEAR_THE_ANTIMERIDIAN_DEG:
            east_deg -= 360.0 * np.rint(east_deg / 360.0)
        north_scale_m, east_scale_m, east_slope_m = metres_per_degree(centre.latitude_deg)
        east_m = (east_scale_m + east_slope_m * north_deg) * east_deg
        north_m = north_scale_m * north_deg
        squared_m2 = north_m * north_m + east_m * east_m
        error_m = _error_m(radius_m)
        inside = squared_m2 <= (radius_m + error_m) ** 2
        if columns.soonest_us <= now_us:
            inside &= columns.expires_at_us > now_us
        return self._nearer(inside.nonzero()[0], squared_m2, radius_m - error_m, centre, radius_m)

    def _nearer(
        self, near: NDArray[np.intp], squared_m2: FloatArray, sure_m: float, centre: LatLon, radius_m: float
    ) -> list[Found]:
        """Those of some features that are within the radius; beyond `sure_m` the geodesic decides."""
        distances_m = np.sqrt(squared_m2[near]).tolist()
        columns = (self._marks, self._bodies, self._latitude_deg, self._longitude_deg)
        if len(distances_m) == 0:
            return []
        if len(distances_m) == 1:
            index = int(near[0])
            found = [(distances_m[0], *(column[index] for column in columns))]
        else:
            picked = itemgetter(*near.tolist())
            found = list(zip(distances_m, *(picked(column) for column in columns), strict=True))
        if max(distances_m) <= sure_m:
            return found
        return [item for item in found if item[0] <= sure_m or _geodesic_m(item, centre) <= radius_m]

    def _as_arrays(self) -> _Columns:
        return _Columns(
            np.array(self._latitude_deg, dtype=np.float64),
            np.array(self._longitude_deg, dtype=np.float64),
            np.array(self._expires_at_us, dtype=np.int64),
            min(self._expires_at_us),
        )

    def _add(self, feature: Served) -> None:
        self._drop(feature.mark[:_ID_BYTES])
        self._index[feature.mark[:_ID_BYTES]] = len(self._marks)
        self._marks.append(feature.mark)
        self._bodies.append(feature.body)
        self._latitude_deg.append(feature.latitude_deg)
        self._longitude_deg.append(feature.longitude_deg)
        self._expires_at_us.append(feature.expires_at_us)
        self.size_bytes += _OVERHEAD_BYTES + len(feature.body)

    def _drop(self, identifier: bytes) -> None:
        """Take a feature out, if it is there; the last one takes its place."""
        index = self._index.pop(identifier, None)
        if index is None:
            return
        self.size_bytes -= _OVERHEAD_BYTES + len(self._bodies[index])
        _replace_by_last(self._marks, index)
        _replace_by_last(self._bodies, index)
        _replace_by_last(self._latitude_deg, index)
        _replace_by_last(self._longitude_deg, index)
        _replace_by_last(self._expires_at_us, index)
        if index < len(self._marks):
            self._index[self._marks[index][:_ID_BYTES]] = index


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


def in_order(found: Iterable[Found], centre: LatLon) -> list[Found]:
    """By geodesic distance, then by id; the geodesic is only solved where the local metric cannot tell."""
    ordered = sorted(found)
    if not ordered:
        return ordered
    # No two are closer to a tie than the farthest may be wrong.
    least_gap_m = 2 * _error_m(ordered[-1][0])
    close = [index for index, (one, next_) in enumerate(pairwise(ordered)) if next_[0] - one[0] <= least_gap_m]
    if not close:
        return ordered
    for index in sorted({*close, *(index + 1 for index in close)}):
        ordered[index] = (_geodesic_m(ordered[index], centre), *ordered[index][1:])
    return sorted(ordered)


def _replace_by_last(column: MutableSequence[T], index: int) -> None:
    last = column.pop()
    if index < len(column):
        column[index] = last


def _error_m(distance_m: float) -> float:
    return _LEAST_ERROR_M + _ERROR_PER_M2 * distance_m * distance_m


def _geodesic_m(feature: Found, centre: LatLon) -> float:
    place = LatLon(latitude_deg=feature[3], longitude_deg=feature[4])
    return distance_m(centre, place)
