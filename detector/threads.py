"""Two threads for loops over points that are compiled and do not hold Python's lock."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

# A car's computer has other work; more threads than cores only wait for each other.
MAX_THREADS = 2
# For fewer points starting threads costs more than it saves.
MIN_POINTS = 4096
# Chunks for each thread: the one that finishes first takes what is left.
CHUNKS = 4


def in_chunks(work: Callable[[int, int], None], rows: int, points: int) -> None:
    """Calls `work(start, stop)` for chunks of `range(rows)`, at most two at a time; `points` is how much work it is.

    A chunk may write only its own rows, so that the result does not depend on the threads' timing.
    """
    threads = min(MAX_THREADS, os.cpu_count() or 1)
    if threads < 2 or points < MIN_POINTS:
        work(0, rows)
        return
    count = threads * CHUNKS
    edges = [rows * chunk // count for chunk in range(count + 1)]
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, edges[:-1], edges[1:]))
