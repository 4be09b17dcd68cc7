"""Obstacles as they are served, for the tests of what readers get."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta
from typing import Any
from uuid import UUID

from hypothesis import strategies as st

from contract.geometry import Box, BoxSd, Kind, LatLon, PlaneCovariance
from contract.observation import State
from contract.obstacle import InspectionState, ObstacleFeature, ObstacleProperties, PointGeometry

NOON = datetime(2026, 6, 1, 12, tzinfo=UTC)
ID = UUID("0198a000-0000-7000-8000-000000000001")


def feature(
    kind: Kind = Kind.POTHOLE,
    *,
    state: State = State.CONFIRMED,
    latitude_deg: float = 38.2466,
    longitude_deg: float = 21.7346,
    identifier: UUID = ID,
    **about: Any,
) -> ObstacleFeature:
    properties = {
        "kind": kind,
        "sign": kind.sign,
        "state": state,
        "version": 1,
        "revision": 3,
        "box": Box(length_mm=1000, width_mm=700, yaw_rad=0.3, relief_mm=100),
        "box_sd": BoxSd(ln_length=0.02, ln_width=0.02, ln_area=0.03, relief_mm=5),
        "volume_m3": 0.02,
        "position_covariance": PlaneCovariance(east_m2=1.0, north_m2=0.25),
        "altitude_m": 20.0,
        "confidence": 0.9,
        "as_of": NOON,
        "half_life_s": 30 * 86_400.0,
        "expires_at": NOON + timedelta(hours=10),
        "first_seen": NOON - timedelta(days=3),
        "last_seen": NOON,
        "sightings": 4,
        "witnesses": 3,
    }
    place = LatLon(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
    return ObstacleFeature(
        id=identifier, geometry=PointGeometry.at(place), properties=ObstacleProperties(**(properties | about))
    )


@st.composite
def _boxes(draw: st.DrawFn) -> Box:
    width_mm, length_mm = sorted((draw(st.integers(1, 50_000)), draw(st.integers(1, 50_000))))
    yaw_rad = draw(st.floats(0, math.pi, exclude_max=True))
    return Box(length_mm=length_mm, width_mm=width_mm, yaw_rad=yaw_rad, relief_mm=draw(st.integers(0, 10_000)))


@st.composite
def _covariances(draw: st.DrawFn) -> PlaneCovariance:
    east_m2, north_m2 = draw(st.floats(0, 1e6)), draw(st.floats(0, 1e6))
    correlation = draw(st.floats(-0.999, 0.999))
    cross_m2 = correlation * math.sqrt(east_m2) * math.sqrt(north_m2)
    return PlaneCovariance(east_m2=east_m2, north_m2=north_m2, east_north_m2=cross_m2)


_moments = st.datetimes(datetime(1990, 1, 1), datetime(2100, 1, 1), timezones=st.just(UTC))
boxes, covariances = _boxes(), _covariances()


@st.composite
def features(draw: st.DrawFn) -> ObstacleFeature:
    """Any obstacle that the service could ever serve."""
    first_seen, last_seen, as_of = sorted(draw(st.tuples(_moments, _moments, _moments)))
    return feature(
        draw(st.sampled_from(Kind)),
        state=draw(st.sampled_from(State)),
        latitude_deg=draw(st.floats(-90, 90)),
        longitude_deg=draw(st.floats(-180, 180)),
        identifier=draw(st.uuids()),
        revision=draw(st.integers(1, 10**6)),
        box=draw(boxes),
        position_covariance=draw(covariances),
        altitude_m=draw(st.floats(-1_000, 10_000)),
        confidence=draw(st.floats(0, 1)),
        first_seen=first_seen,
        last_seen=last_seen,
        as_of=as_of,
        expires_at=as_of + draw(st.timedeltas(timedelta(0), timedelta(days=1_000))),
        inspection_state=draw(st.sampled_from(InspectionState)),
    )
