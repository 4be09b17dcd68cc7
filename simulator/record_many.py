"""Several recordings, at once where there are more cores than vehicles."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed

from simulator.dataset import PlannedDrive
from simulator.record import StoppedError, record


def record_many(
    drives: Sequence[PlannedDrive],
    progress: Callable[[PlannedDrive, int], None],
    ended: Callable[[PlannedDrive, BaseException | None], None],
) -> None:
    """Record drives into folders that are not there yet.

    `progress` is told of all vehicles' frames of a drive so far, from several threads; `ended`, in the thread that
    called, of each drive and what it failed of. What `ended` raises ends all others.
    """
    if not drives:
        return
    stop = threading.Event()

    def make(drive: PlannedDrive) -> None:
        def tell(written: list[int]) -> None:
            if stop.is_set():
                raise StoppedError("the others have ended")
            progress(drive, sum(written))

        record(drive.plan, drive.folder, tell)

    with ThreadPoolExecutor(drives_at_once(drives[0].plan.scenario.egos)) as threads:
        making = {threads.submit(make, drive): drive for drive in drives}
        try:
            for future in as_completed(making):
                ended(making[future], future.exception())
        finally:
            stop.set()
            threads.shutdown(wait=False, cancel_futures=True)


def drives_at_once(egos: int) -> int:
    """How many drives keep every core busy: each vehicle has a process, and a process fills a core."""
    return max(1, (os.cpu_count() or 1) // egos)
