"""Cursors: what goes in comes out, and nothing else does."""

from __future__ import annotations

from datetime import UTC, datetime
from uuid import UUID

import pytest
from hypothesis import given
from hypothesis import strategies as st

from server.reading.cursors import cursor_of, position_of

TYPES = (datetime, UUID, float, int)
moments = st.datetimes(timezones=st.just(UTC))
positions = st.tuples(
    moments, st.uuids(), st.floats(allow_nan=False, allow_infinity=False), st.integers(-(2**63) + 1, 2**63 - 1)
)


@given(st.text(), positions)
def test_a_position_comes_back_exactly(scope: str, position: tuple[datetime, UUID, float, int]) -> None:
    cursor = cursor_of(scope, position)
    assert position_of(cursor, scope, TYPES) == position
    assert cursor.replace("-", "").replace("_", "").isalnum()


@given(positions)
def test_a_cursor_belongs_to_its_query(position: tuple[datetime, UUID, float, int]) -> None:
    with pytest.raises(ValueError, match=r"^cursor: "):
        position_of(cursor_of("one", position), "another", TYPES)


@given(st.one_of(st.text(max_size=200), st.binary(max_size=150).map(lambda raw: raw.hex())))
def test_whatever_else_is_sent_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"^cursor: "):
        position_of(text, "one", TYPES)


@pytest.mark.parametrize("position", [(float("inf"),), (float("nan"),)])
def test_a_position_that_no_number_is_is_refused(position: tuple[float]) -> None:
    with pytest.raises(ValueError, match=r"^cursor: "):
        position_of(cursor_of("one", position), "one", (float,))
