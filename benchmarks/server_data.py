"""A million obstacles for the service's benchmark: real records, repeated, in rows as the service has them."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from uuid import UUID

import asyncpg
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from sqlalchemy import Table

from contract.geometry import Box, BoxSd, Kind, LatLon, PlaneCovariance
from contract.observation import Descriptor, State
from server.geometry.quadkey import cell_of, shard_of_cell, shard_of_tile, tile_of_cell
from server.life.identity import obstacle_id
from server.life.obstacle import Obstacle, Place, Shape, Size, Witness
from server.life.policy import COOPERATION, Life
from server.storage import rows, tables
from server.storage.features import feature_of

FloatArray = NDArray[np.float64]

RADIUS_M = 300.0
NEIGHBOURS = 20
"""What a query shall find on average."""
DEGREE_M = 111_320.0
# Copies of a city stand side by side in longitude, where distances stay what they are.
_STEP_DEG = 1.0
_JITTER_M = 5.0
_BATCH = 5_000
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_KINDS = (Kind.POTHOLE,) * 8 + (Kind.BUMP,) * 2


@dataclass(frozen=True, slots=True)
class City:
    """Places (N, 2) of potholes: latitude and longitude in degrees."""

    places_deg: FloatArray

    def stretched(self) -> City:
        """The city drawn apart, or together, until a circle about a place holds `NEIGHBOURS` on average."""
        middle_deg = self.places_deg.mean(axis=0)
        factor = 1.0
        for _ in range(8):
            factor *= math.sqrt(City(middle_deg + factor * (self.places_deg - middle_deg)).neighbours() / NEIGHBOURS)
        return City(middle_deg + factor * (self.places_deg - middle_deg))

    def neighbours(self) -> float:
        """How many places a circle of `RADIUS_M` about one of them holds on average, itself included."""
        tree = KDTree(plane_m(self.places_deg))
        return tree.count_neighbors(tree, RADIUS_M) / len(self.places_deg)


def plane_m(places_deg: FloatArray) -> FloatArray:
    """Places (N, 2) in a plane good enough to count neighbours within a city."""
    east = math.cos(math.radians(float(places_deg[:, 0].mean())))
    return places_deg * np.array([DEGREE_M, DEGREE_M * east])


def recorded_cities(folder: Path) -> list[City]:
    """New York and Syracuse, from `records/` of `folder`; raises `OSError` when a file is not there."""
    return [
        City(_columns(folder / "records" / "nyc_potholes.csv", "lat", "lon")),
        # Its two columns have their names swapped.
        City(_columns(folder / "records" / "syracuse_potholes.csv", "Longitude", "Latitude")),
    ]


def synthetic_city(seed: int, number: int = 20_000) -> City:
    """Potholes along the streets of a grid of 100 m, more of them on some streets than on others."""
    rng = np.random.default_rng(seed)
    side_m = 100.0 * math.ceil(math.sqrt(number) / 4)
    street = 100.0 * np.floor(rng.beta(2, 3, number) * side_m / 100.0)
    along = rng.uniform(0, side_m, number)
    flip = rng.random(number) < 0.5
    east_m, north_m = np.where(flip, street, along), np.where(flip, along, street)
    east_degree_m = DEGREE_M * math.cos(math.radians(43.0))
    return City(np.column_stack([43.0 + north_m / DEGREE_M, -76.0 + east_m / east_degree_m]))


def repeated(cities: list[City], number: int, seed: int) -> FloatArray:
    """Places (number, 2): the stretched cities, jittered by some metres, again and again further east."""
    rng = np.random.default_rng(seed)
    if number < len(cities[0].places_deg):
        cities = [City(_southern(cities[0].places_deg, number))]
    once = np.vstack([city.stretched().places_deg for city in cities])
    copies = []
    for copy in range(math.ceil(number / len(once))):
        jitter_deg = rng.normal(0.0, _JITTER_M / DEGREE_M, once.shape)
        copies.append(once + jitter_deg + np.array([0.0, copy * _STEP_DEG]))
    copies[-1] = _southern(copies[-1], number - (len(copies) - 1) * len(once))
    return np.vstack(copies)


def _southern(places_deg: FloatArray, number: int) -> FloatArray:
    """So many of the places, whole neighbourhoods of them, so that they are as dense as before."""
    return places_deg[np.argsort(places_deg[:, 0], kind="stable")[:number]]


def obstacle_at(place_deg: list[float], number: int, now: datetime, rng: np.random.Generator) -> Obstacle:
    """A plausible obstacle at a latitude and longitude, seen by two witnesses in the days before `now`."""
    position = LatLon(latitude_deg=place_deg[0], longitude_deg=place_deg[1])
    shard = shard_of_cell(cell_of(position))
    last_seen = now - timedelta(hours=float(rng.uniform(1, 100)))
    first_seen = last_seen - timedelta(days=10)
    length_mm, relief_mm = int(rng.integers(300, 2_000)), int(rng.integers(30, 200))
    box = Box(
        length_mm=length_mm,
        width_mm=int(length_mm * rng.uniform(0.5, 0.99)),
        yaw_rad=round(float(rng.uniform(0, 3.14)), 4),
        relief_mm=relief_mm,
    )
    sd = BoxSd(ln_length=0.03, ln_width=0.03, ln_area=0.04, relief_mm=5.0)
    kind = _KINDS[number % len(_KINDS)]
    return Obstacle(
        id=obstacle_id(first_seen, shard, "benchmark", UUID(int=number), 0),
        shard=shard,
        kind=kind,
        kind_votes={kind: 2},
        state=State.CONFIRMED,
        version=1,
        revision=2,
        born_at=position,
        place=Place(position, PlaneCovariance(east_m2=0.6, north_m2=0.6), 20.0, 2.0),
        shape=Shape(box, sd, 0.02, Descriptor(name="shape", version=1, values={"area": 0.7}), (), first_seen),
        references=(Size("front+rear", box, sd, 2),),
        pending=None,
        confidence=0.75,
        as_of=last_seen,
        first_seen=first_seen,
        last_seen=last_seen,
        sightings=2,
        witness_count=2,
        evidence=(Witness(f"first{number % 9973}", (first_seen,)), Witness(f"last{number % 9967}", (last_seen,))),
    )


async def load(url: str, places_deg: FloatArray, seed: int, advance: Callable[[int], None]) -> None:
    """Fill a database that has its schema; `advance` is told the number of obstacles of each step.

    `url` is the service's. A database that was filled before stays as it is.
    """
    rng, life = np.random.default_rng(seed), COOPERATION.life
    connection = await asyncpg.connect(url.replace("+asyncpg", ""))
    versions: Counter[int] = Counter()
    now = datetime.now(UTC)
    try:
        # Tiles come last: without one, an earlier run was broken off.
        if await connection.fetchval("SELECT EXISTS (SELECT FROM tile)"):
            return
        await connection.execute("TRUNCATE obstacle, witness, creation")
        for first in range(0, len(places_deg), _BATCH):
            places = places_deg[first : first + _BATCH].tolist()
            batch = [obstacle_at(place, first + index, now, rng) for index, place in enumerate(places)]
            versions.update(tile_of_cell(cell_of(item.place.position)) for item in batch)
            await _copy(connection, tables.obstacle, (_row(item, life) for item in batch))
            await _copy(connection, tables.witness, (row for item in batch for row in _evidence(item)))
            await _copy(connection, tables.creation, map(_creation, batch))
            advance(len(batch))
        # The events before are pruned; versions go on from there.
        await _copy(connection, tables.tile, (_tile(*item) for item in sorted(versions.items())))
        await connection.execute("VACUUM ANALYZE")
        await connection.execute("CHECKPOINT")
    finally:
        await connection.close()


def _row(obstacle: Obstacle, life: Life) -> dict[str, Any]:
    return rows.row_of(obstacle, life) | {"feature": feature_of(obstacle, life).model_dump_json()}


def _evidence(obstacle: Obstacle) -> Iterator[dict[str, Any]]:
    return (rows.witness_row(obstacle.shard, obstacle.id, witness) for witness in obstacle.evidence)


def _creation(obstacle: Obstacle) -> dict[str, Any]:
    first = obstacle.evidence[0].name
    return {
        "shard": obstacle.shard,
        "obstacle_id": obstacle.id,
        "witness": first,
        "created_at": obstacle.first_seen,
        "outcome": "shared",
    }


def _tile(tile: int, version: int) -> dict[str, Any]:
    return {"shard": shard_of_tile(tile), "tile": tile, "version": version, "lock_seq": version}


async def _copy(connection: asyncpg.Connection, table: Table, values: Iterator[dict[str, Any]]) -> None:
    names = [column.name for column in table.columns]
    records = [tuple(_stored(row[name]) for name in names) for row in values]
    await connection.copy_records_to_table(table.name, records=records, columns=names)


def _stored(value: Any) -> Any:
    """As `server.storage.tables` binds it."""
    return (value - _EPOCH) // timedelta(microseconds=1) if isinstance(value, datetime) else value


def _columns(path: Path, latitude: str, longitude: str) -> FloatArray:
    with path.open(newline="", encoding="utf-8") as file:
        places = [(float(row[latitude]), float(row[longitude])) for row in csv.DictReader(file)]
    return np.array(places)
