"""Encoded features in memory, by tile: what nearby queries are answered from. Bounded; pure but for its own state."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple
from uuid import UUID

import numpy as np
from numpy.typing import NDArray

from contract.geometry import LatLon
from server.geodesy import FloatArray, distance_m, metres_per_degree

# The local metric is within a few parts in a million of the geodesic at 2 km; nearer to the edge the geodesic decides.
_EDGE = 1e-3
# What a cached feature takes besides its text: objects, dictionary entry, arrays.
_OVERHEAD_BYTES = 500


class Served(NamedTuple):
    """A live obstacle as it is served; `expires_at_us` counts from 1970, `mark` is its id and revision."""

    identifier: UUID
    latitude_deg: float
    longitude_deg: float
    expires_at_us: int
    mark: bytes
    body: bytes


class TileChange(NamedTuple):
    """A line of a tile's event log: an obstacle's new value, or None when it is not served from this tile any more."""

    seq: int
    identifier: UUID
    served: Served | None


@dataclass(frozen=True, slots=True)
class _Columns:
    """The features of a tile as arrays, in one order."""

    features: list[Served]
    latitude_deg: FloatArray
    longitude_deg: FloatArray
    expires_at_us: NDArray[np.int64]


class TileFeatures:
    """The live obstacles of one tile, as of a version of the tile."""

    def __init__(self, version: int, features: Iterable[Served]) -> None:
        self.version = version
        self._features = {feature.identifier: feature for feature in features}
        self._columns: _Columns | None = None
        self.size_bytes = sum(map(_size_bytes, self._features.values()))

    def apply(self, change: TileChange) -> None:
        """Take the next change of the tile."""
        self._columns = None
        self.version = change.seq
        if known := self._features.pop(change.identifier, None):
            self.size_bytes -= _size_bytes(known)
        if change.served is not None:
            self._features[change.identifier] = change.served
            self.size_bytes += _size_bytes(change.served)

    def within(self, centre: LatLon, radius_m: float, now_us: int) -> list[tuple[float, Served]]:
        """Features within a geodesic radius (a few km at most) that have not expired, with their distances (m)."""
        columns = self._columns = self._columns or _columns(list(self._features.values()))
        if not columns.features:
            return []
        north_deg = columns.latitude_deg - centre.latitude_deg
        east_deg = columns.longitude_deg - centre.longitude_deg
        # Across the antimeridian.
        east_deg -= 360.0 * np.rint(east_deg / 360.0)
        north_scale_m, east_scale_m, east_slope_m = metres_per_degree(centre.latitude_deg)
        north_m = north_scale_m * north_deg
        east_m = (east_scale_m + east_slope_m * north_deg) * east_deg
        squared_m2 = north_m * north_m + east_m * east_m
        outer_m = radius_m * (1 + _EDGE)
        near = np.flatnonzero((squared_m2 <= outer_m * outer_m) & (columns.expires_at_us > now_us))
        apart = np.sqrt(squared_m2[near]).tolist()
        found = zip(apart, (columns.features[index] for index in near.tolist()), strict=True)
        sure_m = radius_m * (1 - _EDGE)
        return [(apart_m, item) for apart_m, item in found if apart_m <= sure_m or _is_inside(item, centre, radius_m)]


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


def _columns(features: list[Served]) -> _Columns:
    return _Columns(
        features,
        np.array([feature.latitude_deg for feature in features], dtype=np.float64),
        np.array([feature.longitude_deg for feature in features], dtype=np.float64),
        np.array([feature.expires_at_us for feature in features], dtype=np.int64),
    )


def _is_inside(feature: Served, centre: LatLon, radius_m: float) -> bool:
    place = LatLon(latitude_deg=feature.latitude_deg, longitude_deg=feature.longitude_deg)
    return distance_m(place, centre) <= radius_m


def _size_bytes(feature: Served) -> int:
    return len(feature.body) + _OVERHEAD_BYTES
