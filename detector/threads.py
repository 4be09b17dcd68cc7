"""Two threads for loops over points that are compiled and do not hold Python's lock."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

# A car's computer has other work; more threads than cores only wait for each other.
MAX_THREADS = 2
# For fewer points starting threads costs more than it saves.
MIN_POINTS = 4096
# More than threads: the one that finishes first takes what is left.
CHUNKS = 8


def in_chunks(work: Callable[[int, int], None], rows: int, points: int) -> None:
    """Calls `work(start, stop)` for chunks of `range(rows)`, at most two at a time; `points` is how much work it is.

    A chunk may write only its own rows. So the result depends neither on the threads' timing nor, as the chunks are
    the same on every machine, on their number.
    """
    if points < MIN_POINTS:
        work(0, rows)
        return
    edges = [rows * chunk // CHUNKS for chunk in range(CHUNKS + 1)]
    left = deque(pairwise(edges))
    helpers = min(MAX_THREADS, os.cpu_count() or 1) - 1
    if helpers == 0:
        _work_off(left, work)
        return
    # The calling thread is one of the two: starting one costs a third of a millisecond.
    with ThreadPoolExecutor(helpers) as pool:
        others = [pool.submit(_work_off, left, work) for _ in range(helpers)]
        _work_off(left, work)
    for other in others:
        other.result()


def _work_off(left: deque[tuple[int, int]], work: Callable[[int, int], None]) -> None:
    """Calls `work` for chunks that nobody has taken until none is left."""
    while True:
        try:
            start, stop = left.popleft()
        except IndexError:
            return
        work(start, stop)
