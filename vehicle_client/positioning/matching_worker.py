"""The process that matches sweeps for `vehicle_client.positioning.matching_process`, and what they say to each other.

A message is its length and its bytes. The first one that the worker hears is the sensor's place on the car; it answers
with nothing, once it is ready. Then to each sweep with an odometry, with nothing if there is none, or with what failed.

python -m vehicle_client.positioning.matching_worker SOCKET
"""

from __future__ import annotations

import math
import signal
import socket
import struct
import sys

import numpy as np
from numpy.typing import NDArray

from vehicle_client.frames import Matrix
from vehicle_client.positioning.odometry import ScanMatching, measured_speed_mps
from vehicle_client.sources.frame import LidarFrame

_LENGTH = struct.Struct("<I")
_SWEEP = struct.Struct("<ddI?3x")
"""Stamp, speed (NaN: not known), number of points, whether their times follow them; as long as whole numbers of four
bytes, so that the points are where a processor and compiled loops like them."""

_FAILED = b"failed: "


class MatchingError(RuntimeError):
    """A sweep on which the matching failed; the message is of what it raised."""


def send(peer: socket.socket, *parts: bytes | memoryview) -> None:
    """One message. `OSError` if the peer is gone, or does not take it within the socket's time-out."""
    peer.sendall(_LENGTH.pack(sum(len(part) for part in parts)))
    for part in parts:
        peer.sendall(part)


def receive(peer: socket.socket) -> bytearray:
    """One message, waited for. `EOFError` if the peer is gone, `OSError` if it takes longer than the time-out."""
    (length,) = _LENGTH.unpack(_exactly(peer, _LENGTH.size))
    return _exactly(peer, length)


def _exactly(peer: socket.socket, number: int) -> bytearray:
    data = bytearray(number)
    rest = memoryview(data)
    while rest:
        came = peer.recv_into(rest)
        if came == 0:
            raise EOFError("the other side is gone")
        rest = rest[came:]
    return data


def matrix_bytes(matrix: Matrix) -> bytes:
    """A (4, 4) as a message."""
    return np.ascontiguousarray(matrix, dtype="<f8").tobytes()


def matrix_of(message: bytearray) -> Matrix | None:
    """The (4, 4) of an answer, or None. Raises `MatchingError` if the answer says that."""
    if message.startswith(_FAILED):
        raise MatchingError(message[len(_FAILED) :].decode())
    return np.frombuffer(message, dtype="<f8").reshape(4, 4) if message else None


def send_sweep(peer: socket.socket, frame: LidarFrame) -> None:
    """What matching takes of a frame whose points are (N, 3): them, their times, the stamp and the speed."""
    times_s, speed_mps = frame.point_time_s, measured_speed_mps(frame)
    known_mps = math.nan if speed_mps is None else speed_mps
    head = _SWEEP.pack(frame.stamp_s, known_mps, len(frame.points_m), times_s is not None)
    send(peer, head, _bytes_of(frame.points_m), b"" if times_s is None else _bytes_of(times_s))


def _bytes_of(values: NDArray[np.float32]) -> bytes | memoryview:
    # An array of no rows has no bytes to view.
    return np.ascontiguousarray(values, dtype="<f4").reshape(-1).data.cast("B") if values.size else b""


def sweep_of(message: bytearray) -> LidarFrame:
    """The frame of a sweep's message."""
    stamp_s, speed_mps, number, has_times = _SWEEP.unpack_from(message)
    values = np.frombuffer(message, dtype="<f4", offset=_SWEEP.size)
    points_m, times_s = values[: 3 * number].reshape(number, 3), values[3 * number :]
    speed = None if math.isnan(speed_mps) else speed_mps
    return LidarFrame(stamp_s, points_m, speed_mps=speed, point_time_s=times_s if has_times else None)


def work(peer: socket.socket) -> None:
    """Answer until the peer is gone."""
    try:
        vehicle_from_sensor = np.frombuffer(receive(peer), dtype="<f8").reshape(4, 4)
        _load_compiled(vehicle_from_sensor)
        matching = ScanMatching(vehicle_from_sensor)
        send(peer)
        while True:
            send(peer, _answer(matching, sweep_of(receive(peer))))
    except (EOFError, OSError):
        return


def _load_compiled(vehicle_from_sensor: Matrix) -> None:
    """Match a wall that nobody saw: what is compiled is loaded, or compiled, before the first sweep waits for it."""
    wall = np.stack(np.meshgrid([8.0], np.arange(-8.0, 8.0), np.arange(0.0, 8.0)), axis=-1).reshape(-1, 3)
    matching, times_s = ScanMatching(vehicle_from_sensor), np.zeros(len(wall), dtype=np.float32)
    for stamp_s in (0.0, 0.1, 0.2):
        matching.odom_from_vehicle(LidarFrame(stamp_s, wall.astype(np.float32), point_time_s=times_s))


def _answer(matching: ScanMatching, frame: LidarFrame) -> bytes:
    try:
        odom_from_vehicle = matching.odom_from_vehicle(frame)
    except Exception as error:  # told to the drive, which counts it
        return _FAILED + repr(error).encode()
    return b"" if odom_from_vehicle is None else matrix_bytes(odom_from_vehicle)


def main() -> None:
    """Work at the socket that the drive has left open; it alone ends the process."""
    # A terminal and a service manager tell all processes of a drive to end, and it still wants its last answer.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    with socket.socket(fileno=int(sys.argv[1])) as peer:
        work(peer)


if __name__ == "__main__":
    main()
