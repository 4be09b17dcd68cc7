"""Work beside the drive: nobody waits for it, and nothing that goes wrong in it is lost."""

from __future__ import annotations

import logging
import threading

import pytest

from vehicle_client.beside import Beside

PATIENCE_S = 20


def test_everything_that_was_added_is_done_in_its_order() -> None:
    done: list[int] = []
    beside = Beside(done.append, name="work", most_waiting=100)
    for number in range(100):
        beside.add(number)
    beside.close()
    assert done == list(range(100))
    assert beside.dropped == 0


def test_what_cannot_be_kept_up_with_is_left_out_counted_and_said_once(caplog: pytest.LogCaptureFixture) -> None:
    began, go, done = threading.Event(), threading.Event(), list[int]()

    def work(number: int) -> None:
        began.set()
        assert go.wait(PATIENCE_S)
        done.append(number)

    beside = Beside(work, name="the drawing", most_waiting=2)
    with caplog.at_level(logging.WARNING):
        beside.add(0)
        assert began.wait(PATIENCE_S)
        for number in range(1, 10):
            beside.add(number)
        go.set()
        beside.close()
    assert (done, beside.dropped) == ([0, 1, 2], 7)
    assert [record.getMessage() for record in caplog.records] == [
        "the drawing cannot keep up with the drive: it leaves frames out",
        "the drawing left 7 frames out",
    ]


def test_after_a_failure_nothing_more_is_done_and_closing_raises_it() -> None:
    done: list[int] = []

    def work(number: int) -> None:
        done.append(10 // number)

    beside = Beside(work, name="work", most_waiting=10)
    for number in (5, 0, 2):
        beside.add(number)
    with pytest.raises(ZeroDivisionError):
        beside.close()
    assert done == [2]
