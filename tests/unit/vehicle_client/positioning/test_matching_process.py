"""Sweeps matched in another process: the same poses, and a drive that outlives whatever happens to that process."""

from __future__ import annotations

import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import psutil
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.vehicle_client.making import NOON_S, planar
from tests.unit.vehicle_client.positioning.test_odometry import MAST, yard
from vehicle_client.frames import apply
from vehicle_client.positioning import matching_process, matching_worker
from vehicle_client.positioning.matching_process import MatchingProcess
from vehicle_client.positioning.matching_worker import MatchingError, matrix_of, receive, send, send_sweep, sweep_of
from vehicle_client.positioning.odometry import ScanMatching
from vehicle_client.positioning.odometry_history import ODOMETRY_GAP_S
from vehicle_client.sources.frame import LidarFrame

THINGS = yard()
PATIENCE_S = 60
"""A guard against hanging, not a measurement."""


def sweep(index: float, *, points: np.ndarray | None = None) -> LidarFrame:
    """Of a car that drives straight on at 5 m/s, ten a second."""
    seen = apply(planar(-0.5 * index, 0, 0.0), THINGS).astype(np.float32) if points is None else points
    return LidarFrame(NOON_S + index / 10, seen)


@pytest.fixture
def matching() -> Iterator[MatchingProcess]:
    with closing(MatchingProcess(MAST, waits=True)) as matching:
        yield matching


def ended(pid: int) -> bool:
    deadline_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline_s:
        if not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE:
            return True
        time.sleep(0.02)
    return False


def after_the_silence(index: int) -> int:
    return index + int(10 * ODOMETRY_GAP_S) + 2


def test_the_poses_are_those_of_matching_here_also_over_sweeps_that_say_nothing(matching: MatchingProcess) -> None:
    here = ScanMatching(MAST)
    nothing = [np.empty((0, 3)), np.full((500, 3), np.nan), np.zeros((500, 2)), np.full((500, 3), 1e38)]
    for index in range(6):
        frame = sweep(index)
        matching.begin(frame)
        found, expected = matching.odom_from_vehicle(frame), here.odom_from_vehicle(frame)
        assert found is not None
        assert np.array_equal(found, expected)
        empty = sweep(index + 0.2, points=nothing[index % len(nothing)].astype(np.float32))
        assert matching.odom_from_vehicle(empty) is None
        assert here.odom_from_vehicle(empty) is None


def test_a_sweep_whose_answer_nobody_took_does_not_answer_the_next(matching: MatchingProcess) -> None:
    here = ScanMatching(MAST)
    for index in range(3):
        matching.begin(sweep(index))
        expected = here.odom_from_vehicle(sweep(index))
    assert np.array_equal(matching.odom_from_vehicle(sweep(2)), expected)


def test_nobody_waits_for_a_process_that_loads_its_libraries() -> None:
    with closing(MatchingProcess(MAST, waits=False)) as matching:
        assert matching.odom_from_vehicle(sweep(0)) is None
        deadline_s = time.monotonic() + PATIENCE_S
        while (found := matching.odom_from_vehicle(sweep(1))) is None and time.monotonic() < deadline_s:
            time.sleep(0.05)
    assert found is not None


def test_after_a_kill_odometry_begins_anew_when_nobody_takes_it_for_a_way(
    matching: MatchingProcess, caplog: pytest.LogCaptureFixture
) -> None:
    for index in range(4):
        assert matching.odom_from_vehicle(sweep(index)) is not None
    killed = matching.pid
    assert killed is not None
    os.kill(killed, signal.SIGKILL)
    with caplog.at_level(logging.WARNING):
        silent = [matching.odom_from_vehicle(sweep(index)) for index in range(4, 4 + int(10 * ODOMETRY_GAP_S) - 1)]
    assert silent == [None] * len(silent)
    assert [record.getMessage().partition(":")[0] for record in caplog.records] == ["scan matching broke off"]
    anew = matching.odom_from_vehicle(sweep(after_the_silence(4)))
    assert anew is not None
    assert anew == pytest.approx(np.eye(4), abs=1e-6)
    assert matching.pid != killed


def test_a_process_that_hangs_is_ended_and_begun_anew(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(matching_process, "ANSWERS_WITHIN_S", 0.3)
    with closing(MatchingProcess(MAST, waits=True)) as matching:
        assert matching.odom_from_vehicle(sweep(0)) is not None
        hanging = matching.pid
        assert hanging is not None
        os.kill(hanging, signal.SIGSTOP)
        assert matching.odom_from_vehicle(sweep(1)) is None
        assert ended(hanging)
        monkeypatch.setattr(matching_process, "ANSWERS_WITHIN_S", 60.0)
        assert matching.odom_from_vehicle(sweep(after_the_silence(1))) is not None


def test_a_process_that_always_ends_is_not_begun_with_each_sweep(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[str] = []
    real = subprocess.Popen

    def counted(command: list[str], **options: object) -> subprocess.Popen[bytes]:
        begun.append(command[0])
        return real([sys.executable, "-c", ""], **options)  # type: ignore[call-overload,no-any-return]  # handed on

    monkeypatch.setattr(subprocess, "Popen", counted)
    with closing(MatchingProcess(MAST, waits=True)) as matching:
        assert [matching.odom_from_vehicle(sweep(index)) for index in range(50)] == [None] * 50
    assert len(begun) == 2


def test_a_program_that_cannot_be_begun_costs_the_odometry_and_not_the_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    with closing(MatchingProcess(MAST, waits=True)) as matching:
        assert matching.odom_from_vehicle(sweep(0)) is None
        assert matching.pid is None


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_what_tells_all_processes_of_a_drive_to_end_does_not_take_its_odometry(
    matching: MatchingProcess, number: signal.Signals
) -> None:
    assert matching.odom_from_vehicle(sweep(0)) is not None
    assert matching.pid is not None
    os.kill(matching.pid, number)
    assert matching.odom_from_vehicle(sweep(1)) is not None


def test_a_parent_that_is_killed_leaves_no_process_behind() -> None:
    program = (
        "import numpy as np, time\n"
        "from vehicle_client.positioning.matching_process import MatchingProcess\n"
        "kept = MatchingProcess(np.eye(4), waits=False)\n"
        "print(kept.pid, flush=True)\n"
        "time.sleep(600)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        assert psutil.pid_exists(worker)
        parent.kill()
    assert ended(worker)


def test_closing_ends_the_process(matching: MatchingProcess) -> None:
    pid = matching.pid
    assert pid is not None
    matching.close()
    assert not psutil.pid_exists(pid)
    matching.close()


def test_a_sweep_on_which_the_matching_fails_is_told_and_the_next_is_matched(monkeypatch: pytest.MonkeyPatch) -> None:
    class Failing(ScanMatching):
        def odom_from_vehicle(self, frame: LidarFrame) -> np.ndarray | None:
            if frame.stamp_s == NOON_S:
                raise RuntimeError("the map is torn")
            return super().odom_from_vehicle(frame)

    monkeypatch.setattr(matching_worker, "ScanMatching", Failing)
    ours, theirs = socket.socketpair()
    with ours:
        worker = threading.Thread(target=matching_worker.work, args=(theirs,))
        worker.start()
        send(ours, matching_worker.matrix_bytes(MAST))
        assert receive(ours) == b""
        send_sweep(ours, sweep(0))
        with pytest.raises(MatchingError, match="the map is torn"):
            matrix_of(receive(ours))
        send_sweep(ours, sweep(1))
        assert matrix_of(receive(ours)) is not None
    worker.join(PATIENCE_S)
    assert not worker.is_alive()


@settings(max_examples=50, deadline=None)
@given(
    number=st.integers(0, 2_000),
    with_times=st.booleans(),
    speed_mps=st.none() | st.floats(-5, 80),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_sweep_arrives_as_it_was_sent(number: int, with_times: bool, speed_mps: float | None, seed: int) -> None:
    random = np.random.default_rng(seed)
    points = random.normal(0, 30, (2 * number, 3)).astype(np.float32)[::2]
    times = random.uniform(-0.1, 0, number).astype(np.float32) if with_times else None
    ours, theirs = socket.socketpair()
    with ours, theirs:
        send_sweep(ours, LidarFrame(NOON_S + 0.1, points, speed_mps=speed_mps, point_time_s=times))
        came = sweep_of(receive(theirs))
    assert (came.stamp_s, came.speed_mps) == (NOON_S + 0.1, speed_mps)
    assert came.points_m.flags.aligned
    assert np.array_equal(came.points_m, points)
    assert (came.point_time_s is None) == (times is None)
    assert times is None or np.array_equal(came.point_time_s, times)
