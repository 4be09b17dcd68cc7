"""Chunks cover every row once, whatever the number of threads."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from detector import threads
from detector.threads import in_chunks


@given(st.integers(0, 5000), st.sampled_from([10, 100_000]))
def test_every_row_is_worked_on_once(rows: int, points: int) -> None:
    times = np.zeros(rows, dtype=np.int64)

    def count(start: int, stop: int) -> None:
        times[start:stop] += 1

    in_chunks(count, rows, points)
    assert (times == 1).all()


def test_the_chunks_are_the_same_with_one_core_as_with_many(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    for cores in (1, 2, 64):
        monkeypatch.setattr(threads.os, "cpu_count", lambda cores=cores: cores)
        chunks: list[tuple[int, int]] = []
        in_chunks(lambda start, stop, chunks=chunks: chunks.append((start, stop)), 1000, 100_000)
        seen.append(sorted(chunks))
    assert seen[0] == seen[1] == seen[2]


def test_never_more_than_two_threads_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads.os, "cpu_count", lambda: 64)
    names = set()
    in_chunks(lambda start, stop: names.add(threading.current_thread().name), 1000, 100_000)
    assert len(names) <= 2


def test_an_error_in_a_chunk_reaches_the_caller() -> None:
    def fail(start: int, stop: int) -> None:
        raise ValueError(f"rows {start} to {stop}")

    with pytest.raises(ValueError, match="rows"):
        in_chunks(fail, 100, 100_000)
