"""DATEX II: well-formed, in the schema's namespaces and order."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.geometry import Kind
from contract.observation import State
from contract.obstacle import ObstacleFeature
from server.formats.datex import COMMON, INSTANCE_TYPE, LOCATION, PAYLOAD, SITUATION, publication
from tests.unit.server.served import ID, NOON, feature, features

# The sequence of the complex type SituationRecord, version 3, as far as it is used here.
ORDER = [
    "situationRecordCreationTime",
    "situationRecordObservationTime",
    "situationRecordVersionTime",
    "probabilityOfOccurrence",
    "safetyRelatedMessage",
    "validity",
    "generalPublicComment",
    "locationReference",
]


def parsed(text: bytes) -> ET.Element:
    return ET.fromstring(text)  # noqa: S314  # our own text


def record(served: ObstacleFeature) -> ET.Element:
    found = parsed(publication([served], NOON)).find(f"{SITUATION}situation/{SITUATION}situationRecord")
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("kind", "cls", "element", "value"),
    [
        (
            Kind.POTHOLE,
            "NonWeatherRelatedRoadConditions",
            "nonWeatherRelatedRoadConditionType",
            "roadSurfaceInPoorCondition",
        ),
        (
            Kind.BUMP,
            "NonWeatherRelatedRoadConditions",
            "nonWeatherRelatedRoadConditionType",
            "roadSurfaceInPoorCondition",
        ),
        (Kind.DEBRIS, "GeneralObstruction", "obstructionType", "objectOnTheRoad"),
    ],
)
def test_a_kind_has_its_class_and_type(kind: Kind, cls: str, element: str, value: str) -> None:
    found = record(feature(kind))
    assert found.get(INSTANCE_TYPE) == f"sit:{cls}"
    assert found.findtext(f"{SITUATION}{element}") == value


def test_a_record_follows_the_order_of_the_schema() -> None:
    found = record(feature())
    assert [child.tag.removeprefix(SITUATION) for child in found][:-1] == ORDER
    assert (found.get("id"), found.get("version")) == (f"{ID}-1", "3")


def test_what_was_removed_has_ended() -> None:
    validity = f"{SITUATION}validity/{COMMON}"
    live, gone = record(feature()), record(feature(state=State.REMOVED))
    assert live.findtext(f"{validity}validityStatus") == "active"
    assert gone.findtext(f"{validity}validityStatus") == "definedByValidityTimeSpec"
    assert gone.findtext(f"{validity}validityTimeSpecification/{COMMON}overallEndTime") == "2026-06-01T12:00:00.000Z"


@given(st.lists(features(), max_size=3))
def test_any_publication_is_well_formed_with_declared_prefixes(served: list[ObstacleFeature]) -> None:
    text = publication(served, NOON)
    root = parsed(text)
    assert root.tag == f"{PAYLOAD}payload"
    assert len(root.findall(f"{SITUATION}situation")) == len(served)
    for element in root.iter():
        prefix = element.get(INSTANCE_TYPE, "").partition(":")[0]
        assert not prefix or f"xmlns:{prefix}=".encode() in text


@given(features())
def test_a_place_is_written_to_a_centimetre(served: ObstacleFeature) -> None:
    point = f"{SITUATION}locationReference/{LOCATION}pointByCoordinates/{LOCATION}pointCoordinates/{LOCATION}"
    found = record(served)
    written = [float(found.findtext(f"{point}{name}") or "nan") for name in ("latitude", "longitude")]
    position = served.position
    assert written == pytest.approx([position.latitude_deg, position.longitude_deg], abs=1e-7)
