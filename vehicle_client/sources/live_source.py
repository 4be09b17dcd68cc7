"""Sensors on the car's network: datagrams by UDP, or a stream by TCP."""

from __future__ import annotations

import ipaddress
import logging
import socket
import struct
import threading
import time
import zlib
from collections.abc import Generator, Iterator
from typing import Protocol

from vehicle_client.sources.assembling import Assembler
from vehicle_client.sources.complaints import Complaints
from vehicle_client.sources.frame import LidarFrame, SourceError
from vehicle_client.sources.live_message import HEADER, Head, decode_payload, parse_head
from vehicle_client.sources.live_parts import Parts

LOG = logging.getLogger(__name__)

LISTEN_S = 0.2
"""How long a read may wait before it is seen whether the source was closed."""

SILENT_AFTER_S = 5.0
"""After so long without a word the driver's engineer is told, and a TCP connection is made anew."""

RECEIVE_BUFFER_BYTES = 8 * 2**20
"""Some sweeps; the kernel gives no more than net.core.rmem_max."""

BACK_OFF_S = (0.2, 0.5, 1.0, 2.0, 5.0)
"""Between attempts to connect: a sensor starts in some seconds, and may stay away for a night."""

CLOCK_WENT_BACK = 100
"""Sweeps in a row that come before the last used one. Stamps must rise, so the drive ends, and a new one may begin."""


class Carrier(Protocol):
    """How messages come: by datagrams or by a stream."""

    def messages(self, closing: threading.Event) -> Iterator[tuple[Head, bytes] | None]:
        """Whole messages; None at least every `LISTEN_S`, so that one may look up."""
        ...


class LiveSource:
    """Frames as they come, until `close` is called from another thread. Its length is 0, since nobody knows it.

    The kernel's buffer holds a few milliseconds of datagrams: iterate in a thread that does nothing else. `SourceError`
    ends the iteration when the sensor's clock went back for good.
    """

    def __init__(self, carrier: Carrier, complaints: Complaints) -> None:
        self._carrier, self._complaints = carrier, complaints
        self._closing = threading.Event()

    @property
    def skipped(self) -> int:
        """How many messages could not be used so far."""
        return self._complaints.count

    def __len__(self) -> int:
        return 0

    def __iter__(self) -> Iterator[LidarFrame]:
        assembler = Assembler(self._complaints)
        heard_s, silent = time.monotonic(), False
        for message in self._carrier.messages(self._closing):
            if message is None:
                if not silent and time.monotonic() - heard_s > SILENT_AFTER_S:
                    silent = True
                    LOG.warning("nothing came from the sensor for %.0f s", SILENT_AFTER_S)
                continue
            heard_s, silent = time.monotonic(), False
            yield from self._frames(assembler, *message)

    def close(self) -> None:
        """End the iteration: within `LISTEN_S`, while a connection is being made within `SILENT_AFTER_S`."""
        self._closing.set()

    def _frames(self, assembler: Assembler, head: Head, payload: bytes) -> Iterator[LidarFrame]:
        try:
            readings = decode_payload(head.kind, head.stamp_ns, payload)
        except SourceError as error:
            self._complaints.add(f"a live message is left out: {error}")
            return
        yield from assembler.frames(readings)
        if assembler.gate.refused_in_a_row >= CLOCK_WENT_BACK:
            raise SourceError(
                f"the sensor's clock went back: {CLOCK_WENT_BACK} sweeps in a row are older than the last; start again"
            )


class UdpCarrier:
    """Datagrams at an address of this machine, or of a multicast group; `SourceError` where it cannot be used."""

    def __init__(self, host: str, port: int, complaints: Complaints) -> None:
        self._parts = Parts(complaints)
        try:
            family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
            self._socket.bind(address)
            self._join(host)
        except (OSError, OverflowError) as error:
            raise SourceError(f"udp://{host}:{port}: cannot listen there: {error}") from error
        self._socket.settimeout(LISTEN_S)

    @property
    def port(self) -> int:
        """Where it listens; the system's choice if it was asked for port 0."""
        return int(self._socket.getsockname()[1])

    def messages(self, closing: threading.Event) -> Iterator[tuple[Head, bytes] | None]:
        """Whole messages, and None in between."""
        with self._socket:
            while not closing.is_set():
                try:
                    datagram, sender = self._socket.recvfrom(65_535)
                except TimeoutError:
                    yield None
                    continue
                yield self._parts.add(sender, datagram)

    def _join(self, host: str) -> None:
        try:
            group = ipaddress.ip_address(host)
        except ValueError:
            return  # a name
        if group.is_multicast and group.version == 4:
            request = struct.pack("=4s4s", group.packed, socket.inet_aton("0.0.0.0"))  # noqa: S104  # any interface
            self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, request)


class TcpCarrier:
    """A stream from a sensor's gateway, which listens; the connection is made anew whenever it fails."""

    def __init__(self, host: str, port: int, complaints: Complaints) -> None:
        self._address, self._complaints = (host, port), complaints

    def messages(self, closing: threading.Event) -> Iterator[tuple[Head, bytes] | None]:
        """Whole messages, and None in between."""
        failures = 0
        while not closing.is_set():
            stream = self._connected(failures)
            if stream is None:
                yield None
            else:
                with stream:
                    for message in self._until_it_breaks(stream, closing):
                        failures = 0 if message is not None else failures
                        yield message
            closing.wait(BACK_OFF_S[min(failures, len(BACK_OFF_S) - 1)])
            failures += 1

    def _connected(self, failures: int) -> socket.socket | None:
        try:
            return socket.create_connection(self._address, timeout=SILENT_AFTER_S)
        except OSError as error:
            if failures == 0:
                LOG.warning("tcp://%s:%d: %s; trying again", *self._address, error)
            return None

    def _until_it_breaks(self, stream: socket.socket, closing: threading.Event) -> Iterator[tuple[Head, bytes] | None]:
        stream.settimeout(LISTEN_S)
        try:
            yield from self._read(stream, closing)
        except OSError as error:
            self._complaints.add(f"tcp://{self._address[0]}:{self._address[1]}: {error}; trying again")

    def _read(self, stream: socket.socket, closing: threading.Event) -> Iterator[tuple[Head, bytes] | None]:
        """Messages of one connection; `OSError` when it ends, says nothing for long or makes no sense."""
        while True:
            start = yield from self._exactly(stream, HEADER.size, closing)
            if start is None:
                return
            head = parse_head(start)
            if head is None or head.parts != 1:
                raise ConnectionError("what came is no message; the connection is made anew")
            payload = yield from self._exactly(stream, head.length, closing)
            if payload is None:
                return
            if zlib.crc32(payload) != head.crc:
                raise ConnectionError(f"message {head.message} is corrupt; the connection is made anew")
            yield head, payload

    def _exactly(
        self, stream: socket.socket, length: int, closing: threading.Event
    ) -> Generator[None, None, bytes | None]:
        """So many bytes, or None if the source is closed meanwhile."""
        data = bytearray(length)
        have, heard_s = 0, time.monotonic()
        while have < length:
            if closing.is_set():
                return None
            try:
                count = stream.recv_into(memoryview(data)[have:])
            except TimeoutError:
                if time.monotonic() - heard_s > SILENT_AFTER_S:
                    raise ConnectionError(f"nothing came for {SILENT_AFTER_S:.0f} s") from None
                yield None
                continue
            if count == 0:
                raise ConnectionError("the other side closed the connection")
            have, heard_s = have + count, time.monotonic()
        return bytes(data)
