"""Token buckets."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from server.trust.rate_limit import RateLimit

gaps_s = st.lists(st.floats(0, 10), min_size=1, max_size=200)


@given(gaps_s, st.floats(0.1, 100), st.integers(1, 50))
def test_never_more_than_a_burst_and_what_refilled_since(gaps: list[float], rate_hz: float, burst: int) -> None:
    limit = RateLimit(rate_hz, burst)
    now_s, taken_at_s = 1e6, []
    for gap_s in gaps:
        now_s += gap_s
        if limit.take("a", now_s) == 0:
            taken_at_s.append(now_s)
    for first in range(len(taken_at_s)):
        for last in range(first, len(taken_at_s)):
            elapsed_s = taken_at_s[last] - taken_at_s[first]
            assert last - first + 1 <= burst + rate_hz * elapsed_s + 1e-3


@given(gaps_s, st.floats(0.1, 100), st.integers(1, 50))
def test_who_waits_as_told_is_served(gaps: list[float], rate_hz: float, burst: int) -> None:
    limit = RateLimit(rate_hz, burst)
    now_s = 1e6
    for gap_s in gaps:
        now_s += gap_s
        wait_s = limit.take("a", now_s)
        assert 0 <= wait_s <= 1 / rate_hz + 1e-6
        if wait_s:
            now_s += wait_s
            assert limit.take("a", now_s) == 0


def test_a_whole_burst_is_there_at_once_and_not_one_more() -> None:
    limit = RateLimit(20, 100)
    assert [limit.take("a", 12_345.678) for _ in range(100)] == [0] * 100
    assert limit.take("a", 12_345.678) == pytest.approx(0.05)
    assert limit.take("b", 12_345.678) == 0


def test_a_batch_costs_its_reports_and_a_refused_one_nothing() -> None:
    limit = RateLimit(50, 250)
    assert limit.take("a", 0, 100) == 0
    assert limit.take("a", 0, 100) == 0
    assert limit.take("a", 0, 100) == pytest.approx(1)
    assert limit.take("a", 0, 50) == 0


def test_names_are_forgotten_oldest_first() -> None:
    limit = RateLimit(1, 1, most=10)
    for number in range(1_000):
        limit.take(str(number), 0)
    assert len(limit) == 10
    assert limit.take("999", 0) > 0
    assert limit.take("0", 0) == 0
