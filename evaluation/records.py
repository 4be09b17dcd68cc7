"""Records of road crews replayed through the server's rule: how many distinct obstacles are they?

A record is a place, a minute and a vehicle. It becomes a report of one pothole of unknown size, whose pose error is the
stated accuracy; reports are decided in time order as of their own time, and obstacles expire as they would.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import groupby
from math import inf
from pathlib import Path
from uuid import UUID, uuid5

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fcluster, linkage
from sqlalchemy import func, select

from contract.geometry import Box, BoxSd, Kind, LatLon, PlaneCovariance
from contract.observation import Descriptor, Detection, ObservationReport, Origin, View
from server.geometry.geodesy import east_north_m
from server.ingesting.group import Outcome, decide_together
from server.ingesting.ingest import GREATEST_GROUP
from server.ingesting.parcel import Parcel
from server.life.policy import COOPERATION, Policy
from server.operators import Operators
from server.storage import schema, tables
from server.storage.database import Database
from server.upkeep import Upkeep

_NAMES = UUID("0198a000-0000-7000-8000-5265636f7264")
_TIME = "%m/%d/%Y %H:%M"
# No public road lies nearer to a pole (Svalbard's end at 78.9 N, Ushuaia's at 54.9 S).
_NORTHERNMOST_DEG, _SOUTHERNMOST_DEG = 79.0, -56.0
_DEADLINE_S = 30.0


class RecordsError(Exception):
    """The file does not hold records."""


@dataclass(frozen=True, slots=True)
class Record:
    """Somebody worked on a pothole there."""

    at: datetime
    vehicle: str
    position: LatLon


@dataclass(frozen=True, slots=True)
class Replayed:
    """What the rule made of records. `obstacles` counts all that ever were, by state at the end."""

    records: int
    decisions: Counter[str]
    merged: int
    obstacles: Counter[str]
    sightings: NDArray[np.int64] = field(repr=False)


def read_records(path: Path) -> tuple[list[Record], bool]:
    """Records in time order, and whether the names of the coordinate columns were found to be swapped.

    Columns `dtTime` (month/day/year hour:minute), `VehicleName`, `Latitude`, `Longitude`.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        places = np.array([(row["Latitude"], row["Longitude"]) for row in rows], dtype=np.float64).reshape(-1, 2)
        times = [datetime.strptime(row["dtTime"], _TIME).replace(tzinfo=UTC) for row in rows]
        vehicles = [row["VehicleName"] for row in rows]
    except (OSError, KeyError, ValueError) as error:
        raise RecordsError(f"{path}: {error!r}; wanted columns dtTime, VehicleName, Latitude, Longitude") from error
    if not len(places) or not np.isfinite(places).all():
        raise RecordsError(f"{path} holds no records, or some without a place")
    swapped = not _has_roads(places) and _has_roads(places[:, ::-1])
    if swapped:
        places = places[:, ::-1]
    found = [
        Record(at, vehicle, LatLon(latitude_deg=float(latitude), longitude_deg=float(longitude)))
        for at, vehicle, (latitude, longitude) in zip(times, vehicles, places, strict=True)
    ]
    return sorted(found, key=lambda record: record.at), swapped


async def replay_records(
    records: Sequence[Record], accuracy_m: float, url: str, progress: Callable[[int], None]
) -> Replayed:
    """Decide records on a fresh database, day by day; what has expired by a morning is removed then."""
    # Minutes are too coarse to tell a drive across the town from one down the street.
    policy = replace(COOPERATION, plausibility=replace(COOPERATION.plausibility, greatest_speed_mps=inf))
    database = Database.open(url)
    try:
        await schema.upgrade(database)
        upkeep = Upkeep(database, Operators(database, policy.life, _DEADLINE_S, lambda _: None), policy.life)
        decisions: Counter[str] = Counter()
        for day, group in groupby(_parcels(records, accuracy_m), key=lambda parcel: parcel.received_at.date()):
            parcels = list(group)
            morning = datetime(day.year, day.month, day.day, tzinfo=UTC)
            while await upkeep.sweep(morning):
                pass
            for start in range(0, len(parcels), GREATEST_GROUP):
                decisions += await _decided(database, parcels[start : start + GREATEST_GROUP], policy)
            progress(len(parcels))
        return await _counted(database, len(records), decisions)
    finally:
        await database.close()


def distinct_places(records: Sequence[Record], within_m: float) -> int:
    """How many groups records form whose members all lie within a distance of each other (complete linkage)."""
    origin = records[0].position
    offsets_m = np.array([east_north_m(record.position, origin) for record in records])
    if len(offsets_m) < 2:
        return len(offsets_m)
    return int(fcluster(linkage(offsets_m, "complete"), within_m, "distance").max())


def _has_roads(places: NDArray[np.float64]) -> bool:
    latitude_deg, longitude_deg = places.T
    return bool(
        ((latitude_deg >= _SOUTHERNMOST_DEG) & (latitude_deg <= _NORTHERNMOST_DEG)).all()
        and (np.abs(longitude_deg) <= 180).all()
    )


def _parcels(records: Sequence[Record], accuracy_m: float) -> Iterator[Parcel]:
    for number, record in enumerate(records):
        message = _report(record, number, accuracy_m)
        yield Parcel(message, record.at, record.at, record.vehicle, record.vehicle, message.model_dump_json())


def _report(record: Record, number: int, accuracy_m: float) -> ObservationReport:
    return ObservationReport(
        report_id=uuid5(_NAMES, f"{number} {record.vehicle} {record.at.isoformat()}"),
        observed_at=record.at,
        pseudonym=record.vehicle,
        sensor="crew",
        estimator="none",
        origin=Origin(
            position=record.position,
            altitude_m=0.0,
            altitude_sd_m=0.0,
            heading_rad=0.0,
            covariance=PlaneCovariance(east_m2=accuracy_m**2, north_m2=accuracy_m**2),
        ),
        detections=(_POTHOLE,),
    )


# A pothole of usual size, whose size nobody measured: so large a deviation is never compared.
_POTHOLE = Detection(
    kind=Kind.POTHOLE,
    east_m=0.0,
    north_m=0.0,
    covariance=PlaneCovariance(east_m2=0.0, north_m2=0.0),
    box=Box(length_mm=600, width_mm=600, yaw_rad=0.0, relief_mm=60),
    box_sd=BoxSd(ln_length=0.5, ln_width=0.5, ln_area=0.7, relief_mm=40),
    volume_m3=0.01,
    confidence=1.0,
    view=View(front=False, rear=False, hits=5, frames=1, least_range_m=0.0),
    descriptor=Descriptor(name="none", version=1, values={}),
)


async def _decided(database: Database, parcels: Sequence[Parcel], policy: Policy) -> Counter[str]:
    counted: Counter[str] = Counter()
    for outcome in await decide_together(database, parcels, policy):
        if not isinstance(outcome, Outcome):
            raise outcome
        counted.update(item.decision.value for item in outcome.result.detections)
    return counted


async def _counted(database: Database, records: int, decisions: Counter[str]) -> Replayed:
    table = tables.obstacle
    state = func.coalesce(table.c.removed_reason, table.c.state)
    async with database.read() as connection:
        states = {row[0]: row[1] for row in await connection.execute(select(state, func.count()).group_by(state))}
        seen = (await connection.execute(select(table.c.sightings).where(table.c.merged_into.is_(None)))).scalars()
        sightings = np.array(list(seen), dtype=np.int64)
    return Replayed(records, decisions, states.pop("merged", 0), Counter(states), sightings)
