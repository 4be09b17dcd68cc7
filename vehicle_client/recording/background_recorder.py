"""A recording beside the drive: compressing a sweep takes tens of milliseconds, and no warning may wait for it."""

from __future__ import annotations

import logging
import queue
import threading
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from vehicle_client.drive import Step
from vehicle_client.recording.drive_recorder import DriveRecorder
from vehicle_client.sources.frame import LidarFrame

LOG = logging.getLogger(__name__)

MOST_WAITING = 10
"""Steps that wait for the disk: a second, and at most some tens of megabytes."""

Waiting = tuple[Step, NDArray[np.uint8] | None, LidarFrame | None]


class BackgroundRecorder:
    """Gives steps to a `DriveRecorder` in a thread of its own; those that it cannot keep up with are left out, counted.

    with BackgroundRecorder(DriveRecorder(path, calibration)) as recorder:
        recorder.add(step, overlay_bgr)
    """

    def __init__(self, recorder: DriveRecorder) -> None:
        self._recorder = recorder
        self._waiting: queue.Queue[Waiting | None] = queue.Queue(MOST_WAITING)
        self._failed: Exception | None = None
        self.dropped = 0
        self._thread = threading.Thread(target=self._write, name="recording", daemon=True)
        self._thread.start()

    @property
    def stopped(self) -> str | None:
        """Why the recording ended before the drive; None if it did not."""
        return self._recorder.stopped

    def __enter__(self) -> BackgroundRecorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def add(self, step: Step, overlay_bgr: NDArray[np.uint8] | None = None, measured: LidarFrame | None = None) -> None:
        """Keep a step for the writing thread, never waiting for it; arguments as of `DriveRecorder.add`."""
        try:
            self._waiting.put_nowait((step, overlay_bgr, measured))
        except queue.Full:
            self.dropped += 1
            if self.dropped == 1:
                LOG.warning("the recording cannot keep up with the drive: it leaves frames out")

    def close(self) -> None:
        """Write what waits and finish the file; what went wrong in the thread is raised here."""
        self._waiting.put(None)
        self._thread.join()
        if self.dropped:
            LOG.warning("%d frames are not in the recording", self.dropped)
        if self._failed is not None:
            raise self._failed

    def _write(self) -> None:
        while (waiting := self._waiting.get()) is not None:
            if self._failed is None:
                self._add(waiting)
        self._recorder.close()

    def _add(self, waiting: Waiting) -> None:
        try:
            self._recorder.add(*waiting)
        except Exception as error:  # a thread's exception would be lost, and the drive go on unrecorded
            LOG.exception("the recording fails")
            self._failed = error
