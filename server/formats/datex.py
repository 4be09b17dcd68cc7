"""DATEX II version 3 (CEN 16157): a SituationPublication in XML, a situation of one record for each obstacle."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import UTC, datetime
from xml.etree import ElementTree as ET  # writes only, parses nothing

from contract.observation import State
from contract.obstacle import ObstacleFeature, ObstacleProperties
from server.formats.codes import CODES, sentence

_SCHEMA = "http://datex2.eu/schema/3/"
PAYLOAD, COMMON, SITUATION, LOCATION = (
    f"{{{_SCHEMA}{name}}}" for name in ("d2Payload", "common", "situation", "locationReferencing")
)
INSTANCE_TYPE = "{http://www.w3.org/2001/XMLSchema-instance}type"
# Values of xsi:type name their prefixes, so these must stay what they are.
_PREFIXES = {"d2": "d2Payload", "com": "common", "sit": "situation", "loc": "locationReferencing"}
# Twice as likely as not; certain is what several vehicles have seen lately.
_CERTAIN, _PROBABLE = 0.9, 0.66


def publication(features: Iterable[ObstacleFeature], now: datetime) -> bytes:
    """The obstacles as one publication of the moment `now`; a removed one as a situation that has ended."""
    for prefix, name in _PREFIXES.items():
        ET.register_namespace(prefix, _SCHEMA + name)
    attributes = {INSTANCE_TYPE: "sit:SituationPublication", "lang": "en", "modelBaseVersion": "3"}
    root = ET.Element(f"{PAYLOAD}payload", attributes)
    _text(root, f"{COMMON}publicationTime", _moment(now))
    creator = ET.SubElement(root, f"{COMMON}publicationCreator")
    # ISO 3166-1 reserves zz for users: the service does not know the country it runs in.
    _text(creator, f"{COMMON}country", "zz")
    _text(creator, f"{COMMON}nationalIdentifier", "headsup")
    for feature in features:
        _situation(root, feature)
    if root.find(f"{SITUATION}situation") is None:
        # The serialiser does not see a prefix that only the value of xsi:type needs.
        root.set("xmlns:sit", f"{_SCHEMA}situation")
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))


def _situation(root: ET.Element, feature: ObstacleFeature) -> None:
    situation = ET.SubElement(root, f"{SITUATION}situation", {"id": str(feature.id)})
    header = ET.SubElement(situation, f"{SITUATION}headerInformation")
    _text(header, f"{COMMON}confidentiality", "noRestriction")
    _text(header, f"{COMMON}informationStatus", "real")
    _record(situation, feature)


def _record(situation: ET.Element, feature: ObstacleFeature) -> None:
    """Elements in the order of the schema's sequence."""
    properties, codes = feature.properties, CODES[feature.properties.kind]
    attributes = {
        INSTANCE_TYPE: f"sit:{codes.datex_record}",
        "id": f"{feature.id}-1",
        "version": str(properties.revision),
    }
    record = ET.SubElement(situation, f"{SITUATION}situationRecord", attributes)
    _text(record, f"{SITUATION}situationRecordCreationTime", _moment(properties.first_seen))
    _text(record, f"{SITUATION}situationRecordObservationTime", _moment(properties.last_seen))
    _text(record, f"{SITUATION}situationRecordVersionTime", _moment(properties.as_of))
    _text(record, f"{SITUATION}probabilityOfOccurrence", _probability(properties))
    _text(record, f"{SITUATION}safetyRelatedMessage", "true")
    _validity(record, properties)
    _comment(record, properties)
    _location(record, feature)
    _text(record, f"{SITUATION}{codes.datex_element}", codes.datex_type)


def _validity(record: ET.Element, properties: ObstacleProperties) -> None:
    validity = ET.SubElement(record, f"{SITUATION}validity")
    has_ended = properties.state is State.REMOVED
    _text(validity, f"{COMMON}validityStatus", "definedByValidityTimeSpec" if has_ended else "active")
    times = ET.SubElement(validity, f"{COMMON}validityTimeSpecification")
    _text(times, f"{COMMON}overallStartTime", _moment(properties.first_seen))
    _text(times, f"{COMMON}overallEndTime", _moment(properties.as_of if has_ended else properties.expires_at))


def _comment(record: ET.Element, properties: ObstacleProperties) -> None:
    comment = ET.SubElement(ET.SubElement(record, f"{SITUATION}generalPublicComment"), f"{SITUATION}comment")
    _text(ET.SubElement(comment, f"{COMMON}values"), f"{COMMON}value", sentence(properties), {"lang": "en"})


def _location(record: ET.Element, feature: ObstacleFeature) -> None:
    location = ET.SubElement(record, f"{SITUATION}locationReference", {INSTANCE_TYPE: "loc:PointLocation"})
    point = ET.SubElement(location, f"{LOCATION}pointByCoordinates")
    coordinates = ET.SubElement(point, f"{LOCATION}pointCoordinates")
    _text(coordinates, f"{LOCATION}latitude", f"{feature.position.latitude_deg:.7f}")
    _text(coordinates, f"{LOCATION}longitude", f"{feature.position.longitude_deg:.7f}")


def _probability(properties: ObstacleProperties) -> str:
    if properties.confidence >= _CERTAIN:
        return "certain"
    return "probable" if properties.confidence >= _PROBABLE else "riskOf"


def _moment(moment: datetime) -> str:
    return moment.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _text(parent: ET.Element, tag: str, text: str, attributes: dict[str, str] | None = None) -> None:
    ET.SubElement(parent, tag, attributes or {}).text = text
