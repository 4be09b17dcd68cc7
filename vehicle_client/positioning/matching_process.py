"""Scan matching in a process of its own: it takes half of a sweep's time and would hold Python's lock all the while."""

from __future__ import annotations

import logging
import math
import os
import socket
import subprocess
import sys
import time
from multiprocessing.connection import wait

from vehicle_client.frames import Matrix
from vehicle_client.positioning.matching_worker import matrix_bytes, matrix_of, receive, send, send_sweep
from vehicle_client.positioning.odometry import Tracker, is_gap
from vehicle_client.sources.frame import LidarFrame

_LOG = logging.getLogger(__name__)

ANSWERS_WITHIN_S = 2.0
"""Twenty times what a sweep takes: a worker that is silent for longer hangs, and warnings wait for it."""

READY_WITHIN_S = 60.0
"""It loads libraries first: two seconds, and a slow card with a busy processor takes ten times that."""

PAUSE_S, LONGEST_PAUSE_S = 5.0, 600.0
"""Before a third beginning without odometry, then doubled each time: a worker that always ends must not take the
processor from the drive."""


class MatchingProcess(Tracker):
    """`ScanMatching` elsewhere: `begin` hands a sweep over, `odom_from_vehicle` waits for the answer.

    Until the process is ready there is no odometry, unless the caller `waits` for it: the same sweeps then give the
    same poses. One that ends, or hangs, is begun anew, and so is odometry, after a silence that nobody takes for a way.
    It ends with `close`, and when this process ends, however it does. `MatchingError` for a sweep on which the matching
    fails; those after it are matched as before.
    """

    def __init__(self, vehicle_from_sensor: Matrix, *, waits: bool) -> None:
        self._vehicle_from_sensor, self._waits = vehicle_from_sensor, waits
        self._last_s = self._broken_off_s = -math.inf
        self._is_ready = self._is_asked = False
        self._process: subprocess.Popen[bytes] | None = None
        self._pause_s = 0.0
        self._begin_process()

    @property
    def pid(self) -> int | None:
        """Of the process that matches now."""
        return None if self._process is None else self._process.pid

    def begin(self, frame: LidarFrame) -> None:
        """Hand the sweep over; the matching goes on while the caller does something else."""
        if self._is_asked:
            # Whoever began before did not want to know.
            self._answer()
        if not is_gap(self._broken_off_s, frame.stamp_s) or not self._has_got_ready():
            return
        if frame.points_m.ndim != 2 or frame.points_m.shape[1] != 3:
            return
        try:
            send_sweep(self._peer, frame)
            self._is_asked = True
        except OSError as error:
            self._break_off(error)

    def odom_from_vehicle(self, frame: LidarFrame) -> Matrix | None:
        """(4, 4), in the car's frame at the first sweep since odometry began; None where it cannot be said."""
        if not self._is_asked:
            self.begin(frame)
        message = self._answer() if self._is_asked else None
        odom_from_vehicle = None if message is None else matrix_of(message)
        if odom_from_vehicle is not None:
            self._last_s, self._pause_s = frame.stamp_s, 0.0
        return odom_from_vehicle

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None
        self._peer.close()

    def _answer(self) -> bytearray | None:
        self._is_asked = False
        try:
            return receive(self._peer)
        except (EOFError, OSError) as error:
            self._break_off(error)
            return None

    def _break_off(self, error: Exception) -> None:
        _LOG.warning("scan matching broke off: odometry begins anew: %s", error)
        self._is_ready = False
        self._broken_off_s = self._last_s
        self.close()

    def _has_got_ready(self) -> bool:
        """Whether it may be asked now; begins it anew if it has ended."""
        if self._process is None and time.monotonic() - self._begun_s > self._pause_s:
            self._pause_s = min(max(2 * self._pause_s, PAUSE_S), LONGEST_PAUSE_S)
            self._begin_process()
        if self._process is not None and not self._is_ready:
            self._hear_whether_ready()
        return self._is_ready

    def _hear_whether_ready(self) -> None:
        left_s = self._begun_s + READY_WITHIN_S - time.monotonic()
        if wait([self._peer], timeout=max(left_s, 0.0) if self._waits else 0.0):
            self._is_ready = self._answer() is not None
        elif left_s <= 0 or self._waits:
            self._break_off(TimeoutError(f"not ready within {READY_WITHIN_S:.0f} s"))

    def _begin_process(self) -> None:
        self._begun_s = time.monotonic()
        self._peer, theirs = socket.socketpair()
        self._peer.settimeout(ANSWERS_WITHIN_S)
        # Linear algebra on (4, 4) needs no threads, and theirs wait by turning in circles.
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "OPENBLAS_NUM_THREADS": "1"}
        try:
            with theirs:
                self._process = subprocess.Popen(  # noqa: S603  # ourselves
                    [sys.executable, "-P", "-m", "vehicle_client.positioning.matching_worker", str(theirs.fileno())],
                    pass_fds=[theirs.fileno()],
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    start_new_session=True,
                )
            send(self._peer, matrix_bytes(self._vehicle_from_sensor))
        except OSError as error:
            self._break_off(error)
