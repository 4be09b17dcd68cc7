"""Which places no vehicle can have been at."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import timedelta

from hypothesis import given
from hypothesis import strategies as st

from server.geometry.geodesy import offset_from
from server.life.plausibility import LastPlace, is_too_fast
from server.life.policy import COOPERATION
from tests.unit.server.making import NOON, PATRAS

LIMITS = COOPERATION.plausibility
far_m = st.floats(0, 200_000)
seconds = st.floats(0, 2 * LIMITS.speed_window_s)


def after(seconds: float, apart_m: float) -> LastPlace:
    return LastPlace(offset_from(PATRAS, apart_m, 0.0), 1.0, NOON + timedelta(seconds=seconds))


def test_a_kilometre_within_a_second_is_too_fast_and_within_a_minute_is_not() -> None:
    assert is_too_fast(after(0, 0), after(1, 1_000), LIMITS)
    assert not is_too_fast(after(0, 0), after(60, 1_000), LIMITS)
    assert is_too_fast(after(1, 1_000), after(0, 0), LIMITS)


@given(seconds, far_m)
def test_a_policy_without_a_greatest_speed_judges_none(seconds: float, apart_m: float) -> None:
    unlimited = replace(LIMITS, greatest_speed_mps=math.inf)
    assert not is_too_fast(after(0, 0), after(seconds, apart_m), unlimited)
    assert not is_too_fast(after(0, 0), after(0, apart_m), unlimited)
