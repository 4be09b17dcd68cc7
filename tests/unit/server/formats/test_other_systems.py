"""ITIS, Waze and FIWARE."""

from __future__ import annotations

import json

import pytest
from hypothesis import given

from contract.geometry import Kind
from contract.observation import State
from contract.obstacle import ObstacleFeature
from server.formats import fiware, itis, waze
from server.formats.codes import CODES
from server.geometry.geodesy import LatLon, distance_m
from tests.unit.server.served import ID, feature, features


def test_every_kind_has_its_codes() -> None:
    assert {kind: CODES[kind].itis for kind in Kind} == {Kind.POTHOLE: 5905, Kind.BUMP: 5907, Kind.DEBRIS: 552}
    assert {kind: CODES[kind].waze for kind in Kind} == {
        Kind.POTHOLE: "HAZARD_ON_ROAD_POT_HOLE",
        Kind.BUMP: "HAZARD_ON_ROAD",
        Kind.DEBRIS: "HAZARD_ON_ROAD_OBJECT",
    }
    assert {kind: CODES[kind].fiware for kind in Kind} == {
        Kind.POTHOLE: "pothole",
        Kind.BUMP: "hazardOnRoad",
        Kind.DEBRIS: "hazardOnRoad",
    }


def test_itis_says_cleared_when_it_is_gone() -> None:
    assert itis.item(feature())["itis"] == [5905]
    assert itis.item(feature(state=State.REMOVED))["itis"] == [5905, 5942]


def test_what_is_gone_leaves_the_waze_feed() -> None:
    feed = waze.feed([feature(state=State.REMOVED), feature(Kind.DEBRIS)])
    assert [item["subtype"] for item in feed["incidents"]] == ["HAZARD_ON_ROAD_OBJECT"]


@given(features())
def test_the_line_of_an_incident_is_as_long_as_the_obstacle(served: ObstacleFeature) -> None:
    for incident in waze.feed([served])["incidents"]:
        numbers = list(map(float, incident["polyline"].split()))
        ends = [LatLon(latitude_deg=numbers[i], longitude_deg=numbers[i + 1]) for i in (0, 2)]
        # Seven digits of a degree are 1.1 cm each way.
        assert distance_m(*ends) == pytest.approx(served.properties.box.length_mm / 1000, abs=0.03)


def test_a_fiware_alert_is_solved_when_it_is_gone() -> None:
    live, gone = fiware.entity(feature()), fiware.entity(feature(state=State.REMOVED))
    assert (live["id"], live["type"]) == (f"urn:ngsi-ld:Alert:{ID}", "Alert")
    assert [item["status"]["value"] for item in (live, gone)] == ["active", "solved"]


@given(features())
def test_every_attribute_of_an_alert_is_a_normalised_property(served: ObstacleFeature) -> None:
    entity = fiware.entity(served)
    attributes = {name: value for name, value in entity.items() if name not in ("id", "type", "@context")}
    assert {value["type"] for value in attributes.values()} == {"Property", "GeoProperty"}
    assert json.loads(json.dumps(entity, allow_nan=False)) == entity
    assert entity["location"]["value"]["coordinates"] == list(served.geometry.coordinates)
