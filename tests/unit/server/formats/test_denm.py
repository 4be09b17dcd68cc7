"""DENM: the standard's names, units and ranges."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from uuid import UUID

import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.geometry import Box, Kind, PlaneCovariance
from contract.observation import State
from contract.obstacle import ObstacleFeature
from server.formats import denm
from server.life.obstacle import Obstacle
from server.storage.features import feature_of
from tests.unit.server.making import HOUR, NOON, Road, absent, detection, message
from tests.unit.server.served import covariances, feature, features

# ETSI TS 102 894-2: the ranges of the types.
RANGES = {
    "latitude": (-900_000_000, 900_000_000),
    "longitude": (-1_800_000_000, 1_800_000_000),
    "semiMajorConfidence": (1, 4_094),
    "semiMinorConfidence": (1, 4_094),
    "semiMajorOrientation": (0, 3_600),
    "altitudeValue": (-100_000, 800_000),
    "altitudeConfidence": (0, 15),
    "originatingStationID": (0, 2**32 - 1),
    "stationID": (0, 2**32 - 1),
    "sequenceNumber": (0, 65_535),
    "detectionTime": (0, 4_398_046_511_103),
    "referenceTime": (0, 4_398_046_511_103),
    "termination": (0, 1),
    "relevanceDistance": (0, 7),
    "relevanceTrafficDirection": (0, 3),
    "validityDuration": (0, 86_400),
    "stationType": (0, 15),
    "informationQuality": (0, 7),
    "causeCode": (0, 255),
    "subCauseCode": (0, 255),
    "protocolVersion": (0, 255),
    "messageID": (1, 1),
}


def leaves(value: object, name: str = "") -> list[tuple[str, object]]:
    if isinstance(value, dict):
        return [leaf for key, item in value.items() for leaf in leaves(item, key)]
    return [(name, value)]


@given(features())
def test_every_number_is_an_integer_within_its_type(served: ObstacleFeature) -> None:
    for name, value in leaves(denm.message(served)):
        least, greatest = RANGES[name]
        assert type(value) is int, name
        assert least <= value <= greatest, name


def test_a_pothole_as_the_convention_writes_it() -> None:
    management = denm.message(feature())["denm"]["management"]
    assert management["eventPosition"]["latitude"] == 382_466_000
    assert management["eventPosition"]["longitude"] == 217_346_000
    assert management["eventPosition"]["altitude"]["altitudeValue"] == 2_000
    assert management["detectionTime"] == int((NOON - datetime(2004, 1, 1, tzinfo=UTC)) / timedelta(milliseconds=1))
    assert management["validityDuration"] == 36_000
    assert "termination" not in management


@pytest.mark.parametrize(
    ("kind", "size", "cause"),
    [
        (Kind.POTHOLE, (1000, 700, 100), (9, 0)),
        (Kind.POTHOLE, (2000, 1700, 1000), (5, 7)),
        (Kind.BUMP, (3000, 700, 100), (9, 0)),
        (Kind.DEBRIS, (500, 300, 200), (10, 0)),
        (Kind.DEBRIS, (1600, 300, 200), (10, 4)),
        (Kind.DEBRIS, (700, 300, 500), (10, 4)),
    ],
)
def test_causes_follow_kind_and_size(kind: Kind, size: tuple[int, int, int], cause: tuple[int, int]) -> None:
    length_mm, width_mm, relief_mm = size
    box = Box(length_mm=length_mm, width_mm=width_mm, yaw_rad=0.0, relief_mm=relief_mm)
    event = denm.message(feature(kind, box=box))["denm"]["situation"]["eventType"]
    assert (event["causeCode"], event["subCauseCode"]) == cause


def test_a_removed_obstacle_is_a_negation_under_its_own_action_id() -> None:
    live, gone = denm.message(feature()), denm.message(feature(state=State.REMOVED))
    assert gone["denm"]["management"]["termination"] == 1
    assert gone["denm"]["management"]["actionID"] == live["denm"]["management"]["actionID"]


@given(st.sets(st.uuids(), min_size=2, max_size=50))
def test_different_obstacles_have_different_action_ids(identifiers: set[UUID]) -> None:
    assert len(set(map(denm.action_id, identifiers))) == len(identifiers)


def test_the_reference_time_is_later_with_every_revision_of_a_life() -> None:
    road = Road()
    lives: list[Obstacle] = []
    for hour, vehicle in [(9, "ego1"), (4, "ego2"), (5, "late"), (3, "ego3")]:
        road.sees(vehicle, NOON - hour * HOUR, detection())
        lives.append(road.only)
    for hour, vehicle in [(2, "ego4"), (1, "ego5")]:
        road.take(message(vehicle=vehicle, at=NOON - hour * HOUR, inspections=(absent(road.only.id),)))
        lives.append(road.only)
    assert lives[-1].state is State.REMOVED
    by_revision = {item.revision: denm.reference_time(feature_of(item, road.policy.life).properties) for item in lives}
    times = [by_revision[revision] for revision in sorted(by_revision)]
    assert len(times) >= 5
    assert all(before < after for before, after in pairwise(times))


def test_the_ellipse_lies_along_the_worse_direction() -> None:
    east_west = denm.ellipse(PlaneCovariance(east_m2=4.0, north_m2=1.0))
    assert east_west == {"semiMajorConfidence": 490, "semiMinorConfidence": 245, "semiMajorOrientation": 900}
    north_east = denm.ellipse(PlaneCovariance(east_m2=1.0, north_m2=1.0, east_north_m2=0.5))
    assert north_east["semiMajorOrientation"] == 450


@given(covariances)
def test_95_percent_of_the_positions_lie_within_the_ellipse(covariance: PlaneCovariance) -> None:
    ellipse = denm.ellipse(covariance)
    greatest_cm = 100 * math.sqrt(5.991) * math.sqrt(max(covariance.east_m2, covariance.north_m2))
    assert ellipse["semiMajorConfidence"] >= min(4_094, math.floor(greatest_cm))
    assert ellipse["semiMinorConfidence"] <= ellipse["semiMajorConfidence"]
