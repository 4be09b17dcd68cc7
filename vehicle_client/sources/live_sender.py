"""The reference sender of live messages: what a sensor's gateway does, and what replays a recording to a vehicle."""

from __future__ import annotations

import itertools
import math
import socket
import threading
from collections.abc import Iterator
from typing import Protocol

import cv2
from scipy.spatial.transform import Rotation

from vehicle_client.sources.frame import GnssFix, LidarFrame
from vehicle_client.sources.live_message import (
    FIX,
    LARGEST_PAYLOAD,
    MOTION,
    ODOMETRY,
    MessageKind,
    PointEncoding,
    parts_of,
    sweep_payload,
)

DATAGRAM_BYTES = 1_400
"""Payload that fits an Ethernet frame of 1,500 bytes with all headers: a fragmented datagram is lost as a whole."""


class Sending(Protocol):
    """Takes the bytes of a message's parts."""

    @property
    def part_bytes(self) -> int:
        """Most payload of a part."""
        ...

    def send(self, part: bytes) -> None:
        """Send a header and its payload."""
        ...


class UdpSending:
    """Datagrams to an address."""

    part_bytes = DATAGRAM_BYTES

    def __init__(self, host: str, port: int) -> None:
        family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.connect(address)

    def send(self, part: bytes) -> None:
        """Send a header and its payload."""
        self._socket.send(part)

    def close(self) -> None:
        """Give the socket back."""
        self._socket.close()


class TcpSending:
    """Listens at an address, and sends to every vehicle that is connected; one that fails is let go."""

    part_bytes = LARGEST_PAYLOAD

    def __init__(self, host: str, port: int) -> None:
        self._listening = socket.create_server((host, port))
        self._connected: list[socket.socket] = []
        self._lock = threading.Lock()
        threading.Thread(target=self._accept, daemon=True).start()

    @property
    def port(self) -> int:
        """Where it listens; the system's choice if it was asked for port 0."""
        return int(self._listening.getsockname()[1])

    @property
    def vehicles(self) -> int:
        """How many are connected."""
        with self._lock:
            return len(self._connected)

    def send(self, part: bytes) -> None:
        """Send a header and its payload."""
        with self._lock:
            self._connected = [one for one in self._connected if _sent(one, part)]

    def close(self) -> None:
        """Close all connections."""
        self._listening.shutdown(socket.SHUT_RDWR)  # wakes the thread that accepts, as closing alone does not
        self._listening.close()
        with self._lock:
            for one in self._connected:
                one.close()
            self._connected = []

    def _accept(self) -> None:
        while True:
            try:
                vehicle, _ = self._listening.accept()
            except OSError:
                return  # closed
            with self._lock:
                self._connected.append(vehicle)


class LiveSender:
    """Sends all that a frame holds: motions, odometry, fix, picture and, last, the sweep."""

    def __init__(self, sending: Sending, encoding: PointEncoding = PointEncoding.EXACT) -> None:
        self._sending, self._encoding = sending, encoding
        self._numbers = itertools.count()

    def send(self, frame: LidarFrame) -> None:
        """Send a frame's messages in the order in which they are joined again."""
        for kind, stamp_s, payload in messages_of(frame, self._encoding):
            self.send_message(kind, stamp_s, payload)

    def send_message(self, kind: MessageKind, stamp_s: float, payload: bytes) -> None:
        """Send one message."""
        number, stamp_ns = next(self._numbers), round(stamp_s * 1e9)
        for part in parts_of(kind, number, stamp_ns, payload, self._sending.part_bytes):
            self._sending.send(part)


def messages_of(frame: LidarFrame, encoding: PointEncoding) -> Iterator[tuple[MessageKind, float, bytes]]:
    """Kind, Unix time and payload of each message that a frame is made of."""
    for motion in frame.motions:
        values = (_or_nan(motion.speed_mps), _or_nan(motion.yaw_rate_rps), math.nan)
        yield MessageKind.MOTION, motion.stamp_s, MOTION.pack(*values)
    yield MessageKind.MOTION, frame.stamp_s, MOTION.pack(math.nan, math.nan, frame.steering_rad)
    if frame.odom_from_vehicle is not None:
        turn = Rotation.from_matrix(frame.odom_from_vehicle[:3, :3]).as_quat()
        yield MessageKind.ODOMETRY, frame.stamp_s, ODOMETRY.pack(*frame.odom_from_vehicle[:3, 3], *turn)
    for fix in frame.fixes:
        yield MessageKind.FIX, frame.stamp_s if fix.stamp_s is None else fix.stamp_s, fix_payload(fix)
    if frame.image is not None:
        taken_s = frame.stamp_s if frame.image_stamp_s is None else frame.image_stamp_s
        yield MessageKind.IMAGE, taken_s, cv2.imencode(".jpg", frame.image)[1].tobytes()
    yield MessageKind.SWEEP, frame.stamp_s, sweep_payload(frame, encoding)


def fix_payload(fix: GnssFix) -> bytes:
    """A fix, with NaN for what is not known."""
    place = (fix.position.latitude_deg, fix.position.longitude_deg, fix.altitude_m, fix.sd_m, fix.altitude_sd_m)
    return FIX.pack(*place, *(_or_nan(value) for value in (fix.heading_rad, fix.course_rad, fix.speed_mps)))


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def _sent(vehicle: socket.socket, part: bytes) -> bool:
    try:
        vehicle.sendall(part)
    except OSError:
        vehicle.close()
        return False
    return True
