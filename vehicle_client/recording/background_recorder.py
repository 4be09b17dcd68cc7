"""A recording beside the drive: drawing and compressing a sweep and its picture take tens of milliseconds."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from vehicle_client.beside import Beside
from vehicle_client.drive import Step
from vehicle_client.recording.drive_recorder import DriveRecorder
from vehicle_client.sources.frame import LidarFrame

MOST_WAITING = 10
"""Steps that wait for the disk: a second, and at most some tens of megabytes."""

Overlay = Callable[[], NDArray[np.uint8] | None]
"""Draws what the driver was shown, (H, W, 3) uint8 BGR; None where there is no picture."""

Waiting = tuple[Step, Overlay | None, LidarFrame | None]


class BackgroundRecorder:
    """Gives steps to a `DriveRecorder` in a thread of its own; those that it cannot keep up with are left out, counted.

    with BackgroundRecorder(DriveRecorder(path, calibration)) as recorder:
        recorder.add(step, lambda: draw(scene, image))
    """

    def __init__(self, recorder: DriveRecorder) -> None:
        self._recorder = recorder
        self._writing = Beside(self._write, name="the recording", most_waiting=MOST_WAITING)

    @property
    def stopped(self) -> str | None:
        """Why the recording ended before the drive; None if it did not."""
        return self._recorder.stopped

    @property
    def dropped(self) -> int:
        """Steps that are not in the recording."""
        return self._writing.dropped

    def __enter__(self) -> BackgroundRecorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def add(self, step: Step, overlay: Overlay | None = None, measured: LidarFrame | None = None) -> None:
        """Keep a step for the writing thread, which draws the overlay; the rest as of `DriveRecorder.add`."""
        self._writing.add((step, overlay, measured))

    def close(self) -> None:
        """Write what waits and finish the file; what went wrong in the thread is raised here."""
        try:
            self._writing.close()
        finally:
            self._recorder.close()

    def _write(self, waiting: Waiting) -> None:
        step, overlay, measured = waiting
        self._recorder.add(step, None if overlay is None else overlay(), measured)
