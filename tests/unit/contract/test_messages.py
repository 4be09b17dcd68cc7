"""What the contract accepts comes back as it was; what it must refuse it refuses."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta, timezone
from typing import Any
from uuid import UUID

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from contract.events import server_message
from contract.geometry import Box, Kind, LatLon, Message, PlaneCovariance, Sign
from contract.observation import MAX_DETECTIONS, MAX_POINTS, Detection, ObservationBatch
from contract.obstacle import PointGeometry
from tests.unit.contract.messages import any_message, batches, positions, server_messages
from tests.unit.server.making import PATRAS, absent, detection, message

A_BATCH = ObservationBatch(
    sent_at=datetime(2026, 6, 1, 12, tzinfo=UTC),
    reports=(message(detection(), inspections=(absent(UUID(int=1)),)),),
)


def as_json(value: Message) -> Any:
    return json.loads(value.model_dump_json())


def places(value: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Paths of all values inside a JSON document."""
    yield path
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield from places(inner, (*path, key))


def at(document: Any, path: tuple[str | int, ...]) -> Any:
    for key in path:
        document = document[key]
    return document


PLACES = list(places(as_json(A_BATCH)))
NUMBERS = [p for p in PLACES if isinstance(at(as_json(A_BATCH), p), float | int)]
OBJECTS = [p for p in PLACES if isinstance(at(as_json(A_BATCH), p), dict) and p[-1:] != ("values",)]


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(any_message)
def test_every_message_survives_the_wire(sent: Message) -> None:
    assert type(sent).model_validate_json(sent.model_dump_json()) == sent


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(server_messages)
def test_a_vehicle_parses_whatever_the_server_sends_by_its_type(sent: Message) -> None:
    assert server_message.validate_json(sent.model_dump_json()) == sent


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(batches, st.binary(max_size=3), st.integers(0, 10_000))
def test_a_damaged_message_is_accepted_or_refused_but_never_crashes(
    sent: ObservationBatch, damage: bytes, where: int
) -> None:
    text = sent.model_dump_json().encode()
    where %= len(text)
    damaged = text[:where] + damage + text[where + 1 :]
    try:
        parsed = ObservationBatch.model_validate_json(damaged)
    except ValidationError:
        return
    assert ObservationBatch.model_validate_json(parsed.model_dump_json()) == parsed


@pytest.mark.parametrize("path", NUMBERS, ids=lambda p: ".".join(map(str, p)))
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, None, "many"])
def test_no_number_of_a_report_may_be_anything_but_a_finite_number(path: tuple[str | int, ...], bad: object) -> None:
    document = as_json(A_BATCH)
    at(document, path[:-1])[path[-1]] = bad
    with pytest.raises(ValidationError):
        ObservationBatch.model_validate_json(json.dumps(document))
    with pytest.raises(ValidationError):
        ObservationBatch.model_validate(document)


@pytest.mark.parametrize("path", OBJECTS, ids=lambda p: ".".join(map(str, p)))
def test_an_unknown_key_is_refused_everywhere(path: tuple[str | int, ...]) -> None:
    document = as_json(A_BATCH)
    at(document, path)["trajectory"] = []
    with pytest.raises(ValidationError, match="trajectory"):
        ObservationBatch.model_validate(document)


@pytest.mark.parametrize(
    "time",
    [
        datetime(2026, 6, 1, 12),
        datetime(1, 1, 1, tzinfo=timezone(timedelta(hours=14))),
        datetime(9999, 12, 31, 23, tzinfo=timezone(timedelta(hours=-12))),
        "2026-06-01T12:00:00",
        "0001-01-01T00:00:00+14:00",
        "yesterday",
        # Seconds since 1970, in whatever form, and what is no moment.
        1_780_315_200,
        1_780_315_200.5,
        "1780315200",
        "1780315200.5",
        True,
        "2026-06-01",
        "2026-06-01T12:00Z",
        "2026-06-01 12:00:00Z",
        "20260601T120000Z",
    ],
)
def test_times_that_are_no_rfc_3339_with_offset_or_outside_the_calendar_are_refused(time: object) -> None:
    with pytest.raises(ValidationError):
        ObservationBatch.model_validate({"sent_at": time, "reports": A_BATCH.reports})


@pytest.mark.parametrize("time", ["2026-06-01T15:00:00+03:00", "2026-06-01t12:00:00.000000000z"])
def test_a_time_with_an_offset_is_converted_to_utc(time: str) -> None:
    batch = ObservationBatch.model_validate({"sent_at": time, "reports": A_BATCH.reports})
    assert batch.sent_at == datetime(2026, 6, 1, 12, tzinfo=UTC)
    assert batch.sent_at.utcoffset() == timedelta(0)


def test_width_is_never_the_longer_side() -> None:
    assert Box(length_mm=700, width_mm=700, yaw_rad=0, relief_mm=1).width_mm == 700
    with pytest.raises(ValidationError, match="turn yaw_rad"):
        Box(length_mm=700, width_mm=701, yaw_rad=0, relief_mm=1)


@pytest.mark.parametrize(("yaw_rad", "length_mm"), [(math.pi, 900), (-0.001, 900), (0, 900.5), (0, 0)])
def test_yaw_lies_below_pi_and_sides_are_whole_millimetres(yaw_rad: float, length_mm: float) -> None:
    with pytest.raises(ValidationError):
        Box.model_validate({"length_mm": length_mm, "width_mm": 1, "yaw_rad": yaw_rad, "relief_mm": 1})


@given(st.floats(1e-3, 1e3), st.floats(1e-3, 1e3), st.floats(1.001, 30))
def test_a_covariance_that_no_error_can_have_is_refused(east: float, north: float, excess: float) -> None:
    fitting = PlaneCovariance(east_m2=east**2, north_m2=north**2, east_north_m2=-east * north)
    assert fitting.east_north_m2 < 0
    with pytest.raises(ValidationError):
        PlaneCovariance(east_m2=east**2, north_m2=north**2, east_north_m2=excess * east * north)


@pytest.mark.parametrize(("latitude", "longitude"), [(90.001, 0), (-91, 0), (0, 180.001), (0, -181), (math.nan, 0)])
def test_a_position_lies_on_the_earth(latitude: float, longitude: float) -> None:
    with pytest.raises(ValidationError):
        LatLon(latitude_deg=latitude, longitude_deg=longitude)


def test_a_report_has_bounds() -> None:
    for field, value in (
        ("detections", [detection()] * (MAX_DETECTIONS + 1)),
        ("pseudonym", "a name with spaces"),
        ("pseudonym", ""),
        ("sensor", "x" * 65),
    ):
        with pytest.raises(ValidationError, match=field):
            type(A_BATCH.reports[0]).model_validate({**dict(A_BATCH.reports[0]), field: value})
    with pytest.raises(ValidationError, match="points_cm"):
        Detection.model_validate({**dict(detection()), "points_cm": [(0, 0, 0)] * (MAX_POINTS + 1)})


def test_a_message_cannot_be_changed_after_it_was_made() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        PATRAS.latitude_deg = 0.0  # type: ignore[misc]


@given(positions)
def test_geojson_says_longitude_first_and_gives_the_position_back(position: LatLon) -> None:
    geometry = PointGeometry.at(position)
    assert geometry.coordinates == (position.longitude_deg, position.latitude_deg)
    assert geometry.position == position


def test_only_a_pothole_lies_below_the_road() -> None:
    assert {kind: kind.sign for kind in Kind} == {
        Kind.POTHOLE: Sign.NEGATIVE,
        Kind.BUMP: Sign.POSITIVE,
        Kind.DEBRIS: Sign.POSITIVE,
    }
