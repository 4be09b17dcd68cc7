from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from tests.unit.vehicle_client.recording.test_drive_recorder import CALIBRATION, measured, record, step
from vehicle_client.drive import Step
from vehicle_client.recording.background_recorder import MOST_WAITING, BackgroundRecorder
from vehicle_client.recording.drive_recorder import DriveRecorder
from vehicle_client.sources.frame import LidarFrame
from vehicle_client.sources.opening import open_source


class Held(DriveRecorder):
    """A recorder whose disk waits for a signal."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, CALIBRATION, least_free_bytes=0)
        self.go, self.began = threading.Event(), threading.Event()

    def add(self, step: Step, overlay_bgr: np.ndarray | None = None, measured: LidarFrame | None = None) -> None:
        self.began.set()
        assert self.go.wait(20)
        super().add(step, overlay_bgr, measured)


def test_the_thread_writes_the_same_bytes(tmp_path: Path) -> None:
    overlay = np.full((32, 48, 3), 200, np.uint8)
    with BackgroundRecorder(DriveRecorder(tmp_path / "a.mcap", CALIBRATION, least_free_bytes=0)) as recorder:
        for index in range(5):
            recorder.add(step(index), lambda: overlay)
    assert recorder.dropped == 0
    expected = record(tmp_path / "b.mcap", [step(i) for i in range(5)])
    assert (tmp_path / "a.mcap").read_bytes() == expected.read_bytes()


def test_a_slow_disk_costs_frames_of_the_recording_and_no_time_of_the_drive(tmp_path: Path) -> None:
    held = Held(tmp_path / "slow.mcap")
    with BackgroundRecorder(held) as recorder:
        recorder.add(step(0))
        assert held.began.wait(20)
        for index in range(1, MOST_WAITING + 6):
            recorder.add(step(index))  # returns, although nothing is written
        assert recorder.dropped == 5
        held.go.set()
    assert len(list(open_source(tmp_path / "slow.mcap"))) == MOST_WAITING + 1


def test_what_goes_wrong_in_the_thread_is_raised_at_the_end_and_the_file_finished(tmp_path: Path) -> None:
    recorder = BackgroundRecorder(DriveRecorder(tmp_path / "drive.mcap", CALIBRATION, least_free_bytes=0))
    recorder.add(step(0))
    broken = step(1, measured(1))
    recorder.add(Step(**{name: getattr(broken, name) for name in Step.__slots__} | {"detection": None}))
    recorder.add(step(2))
    with pytest.raises(AttributeError):
        recorder.close()
    assert len(list(open_source(tmp_path / "drive.mcap"))) == 1


def test_why_a_recording_ended_early_is_seen_from_outside(tmp_path: Path) -> None:
    with BackgroundRecorder(DriveRecorder(tmp_path / "full.mcap", CALIBRATION, least_free_bytes=2**62)) as recorder:
        recorder.add(step(0))
    assert "GB are free" in recorder.stopped
