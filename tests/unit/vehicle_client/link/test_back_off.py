"""Waiting before trying again: it grows, is bounded, differs from car to car, and heeds what the server asks."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle_client.link.back_off import FIRST_S, GREATEST_S, GREATEST_WAIT_S, delay_s, retry_after_s

NOW = datetime(2026, 6, 1, 12, tzinfo=UTC)
attempts = st.integers(1, 10**9)
jitters = st.floats(0, 1, exclude_max=True)


@given(attempts, jitters)
def test_a_delay_lies_between_half_the_first_and_the_greatest(attempt: int, jitter: float) -> None:
    assert FIRST_S / 2 <= delay_s(attempt, jitter) <= GREATEST_S


@given(attempts, jitters)
def test_no_later_attempt_waits_less(attempt: int, jitter: float) -> None:
    assert delay_s(attempt, jitter) <= delay_s(attempt + 1, jitter)


def test_it_doubles_and_half_of_it_is_chance() -> None:
    assert [delay_s(n, 0.0) for n in range(1, 8)] == [1, 2, 4, 8, 16, 32, 60]
    assert delay_s(4, 0.5) == 6


@given(attempts, jitters, st.floats(0, 1e12))
def test_never_sooner_than_the_server_asked_and_never_for_a_day(attempt: int, jitter: float, asked_s: float) -> None:
    assert min(asked_s, GREATEST_WAIT_S) <= delay_s(attempt, jitter, asked_s) <= 1.1 * GREATEST_WAIT_S


@pytest.mark.parametrize(
    ("header", "seconds"),
    [
        ("7", 7.0),
        (" 120 ", 120.0),
        ("0", 0.0),
        ("Mon, 01 Jun 2026 12:01:30 GMT", 90.0),
        ("Mon, 01 Jun 2026 11:00:00 GMT", 0.0),
        ("9" * 400, float("inf")),
    ],
)
def test_a_wait_is_read_as_a_number_or_a_date(header: str, seconds: float) -> None:
    assert retry_after_s(header, NOW) == seconds


@pytest.mark.parametrize("header", [None, "", "soon", "-5", "1.5", "1e9", "\u0663", "Mon, 99 Jun 2026"])
def test_what_is_neither_is_no_wait(header: str | None) -> None:
    assert retry_after_s(header, NOW) is None
