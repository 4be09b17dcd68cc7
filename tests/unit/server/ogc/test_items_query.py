"""The parameters of `/items`."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any
from uuid import UUID

import pytest
from pydantic import ValidationError

from server.ogc.query import WHOLE_EARTH, Interval, ItemsQuery
from server.reading.around import Key

DAY, NEXT = datetime(2026, 6, 1, tzinfo=UTC), datetime(2026, 6, 2, tzinfo=UTC)


def query(**parameters: Any) -> ItemsQuery:
    return ItemsQuery.model_validate(parameters)


@pytest.mark.parametrize(
    ("text", "interval"),
    [
        ("2026-06-01T00:00:00Z", (DAY, DAY)),
        ("2026-06-01T02:00:00+02:00/2026-06-02T00:00:00Z", (DAY, NEXT)),
        ("../2026-06-02T00:00:00Z", (None, NEXT)),
        ("2026-06-01T00:00:00Z/..", (DAY, None)),
        ("2026-06-01T00:00:00Z/", (DAY, None)),
        ("/2026-06-02T00:00:00Z", (None, NEXT)),
        ("../..", (None, None)),
    ],
)
def test_instants_and_intervals(text: str, interval: tuple[datetime | None, datetime | None]) -> None:
    assert Interval.parsed(text) == Interval(*interval)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "..",
        "yesterday",
        "2026-06-01",
        "2026-06-02T00:00:00Z/2026-06-01T00:00:00Z",
        "a/b/c",
        '1"',
        "2026-06-01T00:00:00",
    ],
)
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(ValidationError, match="datetime: "):
        query(datetime=text)


def test_without_anything_it_is_ten_of_all_that_is_live() -> None:
    asked = query()
    assert (asked.limit, asked.bounds, asked.filters.states) == (10, WHOLE_EARTH, None)


@pytest.mark.parametrize("wrong", [{"limit": "0"}, {"limit": "10001"}, {"bbox": "1,2,3"}, {"foo": "1"}, {"f": "html"}])
def test_what_does_not_fit_is_refused(wrong: dict[str, str]) -> None:
    with pytest.raises(ValidationError):
        query(**wrong)


def test_a_cursor_leads_behind_its_obstacle_and_belongs_to_its_query() -> None:
    key = Key(0.0, UUID(int=7))
    cursor = query(bbox="1,2,3,4").cursor_behind(key)
    assert query(bbox="1,2,3,4", limit="99", cursor=cursor).after() == key
    with pytest.raises(ValidationError, match="cursor: "):
        query(bbox="1,2,3,5", cursor=cursor)
