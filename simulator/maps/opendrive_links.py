"""Whether what an OpenDRIVE map links together is there: CARLA's reader follows every link without looking."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator


def broken_links(root: ET.Element) -> Iterator[str]:
    """Links of roads, lanes and junctions that lead nowhere, in words; ids of roads and lanes are whole numbers."""
    roads = {str(road.get("id")): road for road in root.iterfind("road")}
    junctions = {str(junction.get("id")): junction for junction in root.iterfind("junction")}
    for number, road in roads.items():
        for problem in _road_problems(road, roads, junctions):
            yield f"road {number}: {problem}"
    for number, junction in junctions.items():
        for problem in _junction_problems(junction, roads):
            yield f"junction {number}: {problem}"


def _road_problems(road: ET.Element, roads: dict[str, ET.Element], junctions: dict[str, ET.Element]) -> Iterator[str]:
    home = road.get("junction", "-1")
    if home != "-1" and home not in junctions:
        yield f"its junction {home} is not there"
    sections = road.findall("lanes/laneSection")
    for side, step in (("predecessor", -1), ("successor", 1)):
        link = road.find(f"link/{side}")
        beyond = _lanes_beyond(link, roads)
        if link is not None:
            known = {"road": roads, "junction": junctions}.get(str(link.get("elementType")))
            if known is None or link.get("elementId") not in known:
                yield f"its {side} {link.get('elementType')} {link.get('elementId')} is not there"
            if link.get("elementType") == "road" and link.get("contactPoint") not in ("start", "end"):
                yield f"its {side} has no contactPoint start or end"
        for index, section in enumerate(sections):
            inside = 0 <= index + step < len(sections)
            there = lane_ids(sections[index + step]) if inside else beyond
            for lane in section.iterfind(f"*/lane/link/{side}"):
                if there is not None and lane.get("id") not in there:
                    yield f"a lane's {side} {lane.get('id')} is not there"


def _lanes_beyond(link: ET.Element | None, roads: dict[str, ET.Element]) -> set[str] | None:
    """Lanes of the road that a link leads to, at its contact point; None where the link leads to no road."""
    road = roads.get(str(link.get("elementId"))) if link is not None else None
    if link is None or road is None or link.get("elementType") != "road":
        return None
    sections = road.findall("lanes/laneSection")
    return lane_ids(sections[0 if link.get("contactPoint") == "start" else -1]) if sections else set()


def _junction_problems(junction: ET.Element, roads: dict[str, ET.Element]) -> Iterator[str]:
    for connection in junction.iterfind("connection"):
        incoming, connecting = (roads.get(str(connection.get(name))) for name in ("incomingRoad", "connectingRoad"))
        if incoming is None or connecting is None:
            yield f"connection {connection.get('id')} lacks its incoming or its connecting road"
            continue
        if connection.get("contactPoint") not in ("start", "end"):
            yield f"connection {connection.get('id')} has no contactPoint start or end"
        sections = connecting.findall("lanes/laneSection")
        there = lane_ids(sections[0 if connection.get("contactPoint") == "start" else -1])
        outer = incoming.findall("lanes/laneSection")
        known = lane_ids(outer[0]) | lane_ids(outer[-1])
        for link in connection.iterfind("laneLink"):
            if link.get("from") not in known or link.get("to") not in there:
                yield f"connection {connection.get('id')} links lanes that are not there"


def lane_ids(section: ET.Element) -> set[str]:
    """The ids of a section's lanes, as written."""
    return {str(lane.get("id")) for lane in section.iterfind("*/lane")}
