"""How a drive hears that it is to end: once in order, twice at once, whichever signals they are."""

from __future__ import annotations

import os
import signal

import pytest

from headsup.ending import NUMBERS, EndedEarly, Ending


@pytest.mark.parametrize("second", NUMBERS)
@pytest.mark.parametrize("first", NUMBERS)
def test_the_first_signal_ends_in_order_and_the_second_at_once(first: signal.Signals, second: signal.Signals) -> None:
    before = [signal.getsignal(number) for number in NUMBERS]
    asked: list[None] = []
    with Ending() as ending:
        ending.calls(lambda: asked.append(None))
        os.kill(os.getpid(), first)
        assert asked == [None]
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), second)
    assert asked == [None]
    assert [signal.getsignal(number) for number in NUMBERS] == before


@pytest.mark.parametrize("number", NUMBERS)
def test_before_anybody_can_end_in_order_a_signal_ends_at_once(number: signal.Signals) -> None:
    with Ending(), pytest.raises(EndedEarly):
        os.kill(os.getpid(), number)
