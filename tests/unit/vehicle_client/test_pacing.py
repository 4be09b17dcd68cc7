"""Pace: nothing of a recording is lost that nobody waits for, and of a sensor's sweeps the latest are taken."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from contract.geometry import LatLon
from vehicle_client.faults import MOST_IN_A_ROW
from vehicle_client.pacing import MOST_WAITING, Paced, Queue
from vehicle_client.sources.frame import MOST_INHERITED, GnssFix, LidarFrame, Motion, inheriting


def frames(number: int, step_s: float = 0.01) -> Iterator[LidarFrame]:
    for index in range(number):
        yield LidarFrame(1_000.0 + index * step_s, np.zeros((1, 3), dtype=np.float32))


def numbered(frame: LidarFrame) -> tuple[LidarFrame, int]:
    return frame, round((frame.stamp_s - 1_000.0) / 0.01)


def test_at_the_drive_s_pace_every_frame_comes_in_order() -> None:
    with Paced(frames(200), numbered, realtime=False, is_recorded=True) as paced:
        assert [ready.known for ready in paced] == list(range(200))
        assert paced.dropped == 0


def test_a_drive_that_is_too_slow_gets_the_latest_frames_and_knows_how_many_it_missed() -> None:
    taken = []
    with Paced(frames(60), numbered, realtime=True, is_recorded=True) as paced:
        for ready in paced:
            taken.append(ready.known)
            time.sleep(0.05)
        assert taken == sorted(set(taken))
        assert taken[-1] == 59
        assert paced.dropped == 60 - len(taken) > 0


def test_a_recording_is_held_back_to_its_own_pace() -> None:
    with Paced(frames(5, step_s=0.05), numbered, realtime=True, is_recorded=True) as paced:
        complete_s = [ready.complete_s for ready in paced]
    assert complete_s[-1] - complete_s[0] == pytest.approx(0.2, abs=1e-6)


def test_a_recording_that_is_read_too_slowly_starts_its_clock_anew() -> None:
    def slow() -> Iterator[LidarFrame]:
        for frame in frames(3):
            yield frame
            time.sleep(0.6)

    with Paced(slow(), numbered, realtime=True, is_recorded=True) as paced:
        ages_s = [time.monotonic() - ready.complete_s for ready in paced]
        assert paced.stalls == 2
    assert max(ages_s) < 0.5


def test_what_fails_in_the_source_is_told_to_whoever_takes_the_frames() -> None:
    def source() -> Iterator[LidarFrame]:
        yield from frames(3)
        raise ValueError("source")

    with (
        Paced(source(), numbered, realtime=False, is_recorded=True) as paced,
        pytest.raises(ValueError, match="source"),
    ):
        for _ in paced:
            pass


def failing_in(numbers: range) -> Callable[[LidarFrame], tuple[LidarFrame, int]]:
    def prepare(frame: LidarFrame) -> tuple[LidarFrame, int]:
        ready = numbered(frame)
        if ready[1] in numbers:
            raise ValueError("prepare")
        return ready

    return prepare


def test_a_frame_whose_preparation_fails_is_left_out_logged_once_and_counted(caplog: pytest.LogCaptureFixture) -> None:
    wrong = range(3, 3 + MOST_IN_A_ROW - 1)
    with Paced(frames(60), failing_in(wrong), realtime=False, is_recorded=True) as paced:
        assert [ready.known for ready in paced] == [number for number in range(60) if number not in wrong]
    assert paced.faults.total == len(wrong)
    (said,) = caplog.records
    assert said.exc_info is not None


def test_what_fails_for_too_many_frames_in_a_row_is_told_to_whoever_takes_them() -> None:
    with (
        Paced(frames(60), failing_in(range(3, 60)), realtime=False, is_recorded=True) as paced,
        pytest.raises(ValueError, match="prepare"),
    ):
        assert len(list(paced)) == 3


@pytest.mark.parametrize("realtime", [False, True])
def test_a_drive_that_stops_early_leaves_no_thread_behind(realtime: bool) -> None:
    before = threading.active_count()
    with Paced(frames(10_000), numbered, realtime=realtime, is_recorded=True) as paced:
        for ready in paced:
            if ready.known > 3:
                paced.stop()
    assert threading.active_count() == before


def test_a_queue_that_drops_keeps_the_latest_and_hands_on_what_the_dropped_leave() -> None:
    queue: Queue[list[int]] = Queue(lambda item, dropped: [*dropped, *item])
    for number in range(10):
        queue.put([number])
    queue.end()
    assert list(queue) == [list(range(11 - MOST_WAITING)), *([number] for number in range(11 - MOST_WAITING, 10))]
    assert queue.dropped == 10 - MOST_WAITING


def bringing(number: int) -> LidarFrame:
    fix = GnssFix(LatLon(latitude_deg=38.0, longitude_deg=21.0 + number / 1e6), 0.0, None, 1.0, 2.0)
    motion = Motion(number - 0.05, 5.0)
    return LidarFrame(float(number), np.zeros((0, 3), np.float32), gnss=fix, motions=(motion,))


def test_no_fix_and_no_motion_of_a_dropped_frame_is_lost() -> None:
    taken: list[LidarFrame] = []
    source = (bringing(number) for number in range(40))
    with Paced(source, lambda frame: (frame, None), realtime=True, is_recorded=False) as paced:
        for ready in paced:
            time.sleep(0.01)
            taken.append(ready.frame)
    assert paced.dropped == 40 - len(taken) > 0
    assert [fix.position for frame in taken for fix in frame.fixes] == [
        bringing(n).fixes[0].position for n in range(40)
    ]
    assert [motion for frame in taken for motion in frame.motions] == [bringing(n).motions[0] for n in range(40)]
    assert all(frame.gnss == frame.fixes[-1] for frame in taken)


def test_a_fix_that_is_handed_on_keeps_the_moment_of_its_own_frame() -> None:
    heir = inheriting(bringing(8), bringing(7))
    assert [fix.stamp_s for fix in heir.fixes] == [7.0, None]
    assert heir.stamp_s == 8.0


def test_what_a_stall_of_hours_leaves_is_bounded_and_the_latest() -> None:
    frame = bringing(0)
    for number in range(1, 2 * MOST_INHERITED):
        frame = inheriting(bringing(number), frame)
    assert (len(frame.motions), len(frame.fixes)) == (MOST_INHERITED, MOST_INHERITED)
    assert frame.motions[-1] == bringing(2 * MOST_INHERITED - 1).motions[0]


def test_frames_without_fixes_inherit_none() -> None:
    bare = replace(bringing(1), gnss=None, motions=())
    assert inheriting(bare, bare).fixes == ()
