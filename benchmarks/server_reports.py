"""Reports for the ingest benchmark: what vehicles would send about the obstacles that are stored."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from uuid import UUID

import numpy as np

from benchmarks.server_data import FloatArray
from contract.geometry import Box, BoxSd, Kind, LatLon, PlaneCovariance
from contract.observation import (
    MAX_POINTS,
    Descriptor,
    Detection,
    ObservationBatch,
    ObservationReport,
    Origin,
    View,
)

# A consumer receiver with corrections, and an obstacle within a lane of its origin.
_POSE_SD_M, _OFFSET_M = 0.8, 5.0
# The shape of a pass moves by what repeats: 3 % (see `evaluation`).
_SIZE_SD = 0.03
_NEW_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class Form:
    """What the requests look like: reports in each, detections in each report, points in each detection.

    They come over so many connections, each of which waits for its answer.
    """

    name: str
    reports: int
    detections: int
    points: int
    connections: int


# As many reports wait as at 64 vehicles, and as at a server that is offered all it can take: ten times as many.
FORMS = (
    Form("1 report of 1 detection", 1, 1, 0, 64),
    Form(f"1 report of 2 detections with {MAX_POINTS} points", 1, 2, MAX_POINTS, 64),
    Form("20 reports of 1 detection", 20, 1, 0, 4),
    Form("20 reports of 1 detection", 20, 1, 0, 32),
)


def write_bodies(path: Path, form: Form, number: int, places_deg: FloatArray, seed: int, now: datetime) -> None:
    """Write bodies, one in each line; each of a vehicle of its own, nine in ten reports about what is stored.

    `now` is when they are sent.
    """
    rng = np.random.default_rng(seed)
    with path.open("w", encoding="ascii") as file:
        for body in _bodies(form, number, places_deg, rng, now):
            file.write(body + "\n")


def _bodies(form: Form, number: int, places_deg: FloatArray, rng: np.random.Generator, now: datetime) -> Iterator[str]:
    clouds = [_points(rng, form.points) for _ in range(16)]
    for _ in range(number):
        chosen = int(rng.integers(len(places_deg)))
        vehicle = f"v{rng.integers(1 << 62):x}"
        reports = []
        for index in range(form.reports):
            # Its own street, hour after hour: nobody drives faster than a car.
            place = places_deg[chosen]
            at = now - timedelta(seconds=60 + 3_600 * (form.reports - index) * float(rng.uniform(0.5, 1.0)))
            reports.append(_report(place, vehicle, at, form, clouds, rng))
        yield ObservationBatch(sent_at=now, reports=tuple(reports)).model_dump_json()


def _report(
    place_deg: FloatArray,
    vehicle: str,
    at: datetime,
    form: Form,
    clouds: list[tuple[tuple[int, int, int], ...]],
    rng: np.random.Generator,
) -> ObservationReport:
    away_m = 40.0 if rng.random() < _NEW_SHARE else 0.0
    east_degree_m = 111_320.0 * math.cos(math.radians(place_deg[0]))
    off_m = rng.normal(0.0, _POSE_SD_M, 2) + away_m
    latitude_deg = float(place_deg[0] + (off_m[1] - _OFFSET_M) / 111_320.0)
    origin = Origin(
        position=LatLon(latitude_deg=latitude_deg, longitude_deg=float(place_deg[1] + off_m[0] / east_degree_m)),
        altitude_m=20.0,
        altitude_sd_m=2.0,
        heading_rad=0.0,
        covariance=PlaneCovariance(east_m2=_POSE_SD_M**2, north_m2=_POSE_SD_M**2),
    )
    return ObservationReport(
        report_id=UUID(bytes=rng.bytes(16), version=4),
        observed_at=at,
        pseudonym=vehicle,
        sensor="lidar-64",
        estimator="moment-box-1",
        origin=origin,
        detections=tuple(_detection(number, clouds, rng) for number in range(form.detections)),
    )


def _detection(number: int, clouds: list[tuple[tuple[int, int, int], ...]], rng: np.random.Generator) -> Detection:
    length_mm = int(1_000 * math.exp(rng.normal(0.0, _SIZE_SD)))
    return Detection(
        kind=Kind.POTHOLE,
        # The second one lies across the street.
        east_m=8.0 * number,
        north_m=_OFFSET_M,
        covariance=PlaneCovariance(east_m2=0.0025, north_m2=0.0025),
        box=Box(length_mm=length_mm, width_mm=int(0.7 * length_mm), yaw_rad=0.3, relief_mm=100),
        box_sd=BoxSd(ln_length=_SIZE_SD, ln_width=_SIZE_SD, ln_area=0.04, relief_mm=5.0),
        volume_m3=0.02,
        confidence=0.9,
        view=View(front=True, rear=True, hits=300, frames=12, least_range_m=4.0),
        descriptor=Descriptor(
            name="shape", version=1, values={f"moment{n}": round(float(rng.normal()), 6) for n in range(12)}
        ),
        points_cm=clouds[int(rng.integers(len(clouds)))],
    )


def _points(rng: np.random.Generator, number: int) -> tuple[tuple[int, int, int], ...]:
    east, north, up = rng.integers(-50, 50, number), rng.integers(-35, 35, number), rng.integers(-10, 1, number)
    return tuple(zip(east.tolist(), north.tolist(), up.tolist(), strict=True))
