"""The query of a reader, as one value."""

from __future__ import annotations

import math
from typing import Any
from uuid import UUID

import pytest
from pydantic import ValidationError

from contract.geometry import Kind
from contract.observation import State
from server.geometry.bounds import Bounds
from server.reading.around import Ahead, Circle, Key
from server.reading.query import ObstacleQuery

HERE = {"lat": "38.2", "lon": "21.7"}
KEY = Key(12.345678901234567, UUID(int=5))


def query(**parameters: Any) -> ObstacleQuery:
    return ObstacleQuery.model_validate(parameters)


def test_a_circle_has_a_kilometre_unless_it_says_otherwise() -> None:
    area = query(**HERE).area
    assert isinstance(area, Circle)
    assert (area.centre.latitude_deg, area.centre.longitude_deg, area.radius_m, area.ahead) == (
        38.2,
        21.7,
        1000.0,
        None,
    )


def test_a_heading_makes_it_a_half_plane_and_a_corridor_a_strip() -> None:
    half, strip = query(**HERE, heading_deg="90").area, query(**HERE, heading_deg="90", corridor_m="8").area
    assert isinstance(half, Circle)
    assert isinstance(strip, Circle)
    assert half.ahead == Ahead(math.pi / 2, None)
    assert strip.ahead == Ahead(math.pi / 2, 8.0)


def test_a_box_is_the_other_kind_of_area() -> None:
    assert query(bbox="179,-20,-179,-15").area == Bounds(179, -20, -179, -15)


def test_kinds_and_states_are_repeated_or_listed_with_commas() -> None:
    filters = query(**HERE, kind=["pothole,bump", "debris"], state=["removed"]).filters
    assert filters.kinds == set(Kind)
    assert filters.states == {State.REMOVED}


@pytest.mark.parametrize(
    ("parameters", "says"),
    [
        ({}, "give one area"),
        ({"lat": "1"}, "give one area"),
        ({"radius_m": "5"}, "give one area"),
        (HERE | {"bbox": "0,0,1,1"}, "give one area"),
        ({"bbox": "0,0,1,1", "radius_m": "5"}, "give one area"),
        ({"bbox": "0,0,1,1", "heading_deg": "5"}, "heading_deg needs lat"),
        ({"bbox": "0,1,1,0"}, "south must not exceed north"),
        (HERE | {"corridor_m": "5"}, "corridor_m needs heading_deg"),
        (HERE | {"raduis_m": "5"}, "raduis_m"),
        (HERE | {"kind": ["pothole,puddle"]}, "puddle|kind"),
        (HERE | {"seen_since": "2026-06-01T12:00:00"}, "RFC 3339"),
        (HERE | {"seen_since": "1780315200"}, "RFC 3339"),
        (HERE | {"min_confidence": "1.1"}, "less than or equal to 1"),
        (HERE | {"heading_deg": "nan"}, "finite"),
        (HERE | {"cursor": "AAAA"}, "cursor: "),
    ],
)
def test_what_makes_no_sense_is_refused_by_name(parameters: dict[str, Any], says: str) -> None:
    with pytest.raises(ValidationError, match=says):
        query(**parameters)


def test_a_cursor_leads_behind_its_key() -> None:
    first = query(**HERE, kind=["bump"])
    assert query(**HERE, kind=["bump"], cursor=first.cursor_behind(KEY), limit="7", f="denm").after() == KEY


@pytest.mark.parametrize("other", [{"kind": ["debris"]}, {"radius_m": "999"}, {"heading_deg": "1"}])
def test_a_cursor_of_another_query_is_refused(other: dict[str, Any]) -> None:
    cursor = query(**HERE).cursor_behind(KEY)
    with pytest.raises(ValidationError, match="cursor: "):
        query(**HERE, **other, cursor=cursor)
