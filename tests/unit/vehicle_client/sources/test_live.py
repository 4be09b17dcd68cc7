from __future__ import annotations

import math
import random
import socket
import threading
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.geometry import LatLon
from vehicle_client.sources import live_source
from vehicle_client.sources.complaints import Complaints
from vehicle_client.sources.frame import GnssFix, LidarFrame, Motion, SourceError
from vehicle_client.sources.live_message import (
    HEADER,
    STEP_M,
    Head,
    MessageKind,
    PointEncoding,
    decode_payload,
    parse_head,
    parts_of,
    sweep_payload,
)
from vehicle_client.sources.live_parts import MOST_WAITING, Parts
from vehicle_client.sources.live_sender import DATAGRAM_BYTES, LiveSender, TcpSending, UdpSending
from vehicle_client.sources.live_source import LiveSource, TcpCarrier, UdpCarrier
from vehicle_client.sources.opening import open_source

STAMP_S = 1_780_000_000.0


def measured(index: int, count: int = 600) -> LidarFrame:
    rng = np.random.default_rng(index)
    stamp_s = STAMP_S + 0.1 * index
    return LidarFrame(
        stamp_s,
        rng.normal(0, 20, (count, 3)).astype(np.float32),
        intensity=rng.integers(0, 256, count).astype(np.float32),
        ring=rng.integers(0, 64, count).astype(np.uint16),
        image=np.full((16, 24, 3), 60 + index, np.uint8),
        odom_from_vehicle=np.eye(4),
        gnss=GnssFix(LatLon(latitude_deg=38.2, longitude_deg=21.7), 20.0, 1.25, 0.7, 1.5, stamp_s=stamp_s - 0.03),
        steering_rad=0.25,
        point_time_s=np.linspace(-0.1, 0, count).astype(np.float32),
        motions=(Motion(stamp_s - 0.06, 9.5, 0.125), Motion(stamp_s - 0.01, 10.0, None)),
    )


@contextmanager
def listened_to(source: LiveSource) -> Iterator[Callable[[int], list[LidarFrame]]]:
    """Reads a source in its own thread, as a vehicle does; gives a way to wait for a number of frames."""
    frames: list[LidarFrame] = []
    failed: list[SourceError] = []
    came = threading.Condition()

    def read() -> None:
        try:
            for frame in source:
                with came:
                    frames.append(frame)
                    came.notify_all()
        except SourceError as error:
            with came:
                failed.append(error)
                came.notify_all()

    def wait(count: int) -> list[LidarFrame]:
        with came:
            assert came.wait_for(lambda: failed or len(frames) >= count, timeout=20)
            if failed:
                raise failed[0]
            return list(frames)

    thread = threading.Thread(target=read)
    thread.start()
    try:
        yield wait
    finally:
        source.close()
        thread.join(timeout=20)
        assert not thread.is_alive()


def udp() -> tuple[LiveSource, int, Complaints]:
    complaints = Complaints()
    carrier = UdpCarrier("127.0.0.1", 0, complaints)
    return LiveSource(carrier, complaints), carrier.port, complaints


def assert_same(frame: LidarFrame, sent: LidarFrame, step_m: float) -> None:
    assert frame.stamp_s == pytest.approx(sent.stamp_s, abs=1e-6)
    assert frame.points_m == pytest.approx(sent.points_m, abs=step_m / 2 + 1e-6)
    assert frame.point_time_s == pytest.approx(sent.point_time_s, abs=6e-6)
    assert frame.ring.tolist() == sent.ring.tolist()
    assert frame.intensity.tolist() == sent.intensity.tolist()
    assert np.abs(frame.image.astype(int) - sent.image).max() <= 2
    assert frame.odom_from_vehicle == pytest.approx(sent.odom_from_vehicle)
    assert (frame.gnss.position, frame.gnss.heading_rad) == (sent.gnss.position, sent.gnss.heading_rad)
    assert frame.gnss.sd_m == pytest.approx(sent.gnss.sd_m)
    assert frame.gnss.stamp_s == pytest.approx(sent.gnss.stamp_s, abs=1e-6)
    assert [(m.speed_mps, m.yaw_rate_rps) for m in frame.motions] == [(9.5, 0.125), (10.0, None)]
    assert frame.steering_rad == 0.25


@pytest.mark.parametrize(("encoding", "step_m"), [(PointEncoding.EXACT, 0.0), (PointEncoding.SMALL, STEP_M)])
def test_datagrams_become_the_frames_that_were_sent(encoding: PointEncoding, step_m: float) -> None:
    source, port, complaints = udp()
    sending = UdpSending("127.0.0.1", port)
    sender = LiveSender(sending, encoding)
    with listened_to(source) as wait:
        for index in range(3):
            sender.send(measured(index))
            frames = wait(index + 1)
    sending.close()
    assert len(source) == complaints.count == 0
    for index, frame in enumerate(frames):
        assert_same(frame, measured(index), step_m)


def test_a_stream_becomes_the_frames_that_were_sent_and_is_made_anew_when_it_breaks() -> None:
    first = TcpSending("127.0.0.1", 0)
    complaints = Complaints()
    source = LiveSource(TcpCarrier("127.0.0.1", first.port, complaints), complaints)
    with listened_to(source) as wait:
        _connected(first)
        sender = LiveSender(first)
        for index in range(3):
            sender.send(measured(index))
        wait(3)
        port = first.port
        first.close()
        second = TcpSending("127.0.0.1", port)
        _connected(second)
        LiveSender(second).send(measured(5))
        frames = wait(4)
        second.close()
    assert [round((f.stamp_s - STAMP_S) * 10) for f in frames] == [0, 1, 2, 5]
    assert_same(frames[3], measured(5), 0.0)
    assert complaints.count >= 1


def _connected(sending: TcpSending) -> None:
    for _ in range(400):
        if sending.vehicles:
            return
        threading.Event().wait(0.05)
    raise AssertionError("nobody connected")


@pytest.mark.parametrize(
    "nonsense",
    [
        b"HTTP/1.1 200 OK\r\n\r\n" * 4,
        HEADER.pack(b"HDUP", 1, 1, 0, 1, 0, 0, 2**32 - 1, 0, 0),
        HEADER.pack(b"HDUP", 1, 1, 0, 1, 0, 0, 4, 0, 0) + b"abcd",
        HEADER.pack(b"HDUP", 2, 1, 0, 1, 0, 0, 0, 0, 0),
    ],
)
def test_a_stream_of_nonsense_is_left_and_tried_again(nonsense: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        complaints = Complaints()
        source = LiveSource(TcpCarrier("127.0.0.1", server.getsockname()[1], complaints), complaints)
        with listened_to(source) as wait:
            vehicle, _ = server.accept()
            vehicle.sendall(nonsense)
            again, _ = server.accept()
            payload = sweep_payload(measured(0), PointEncoding.EXACT)
            again.sendall(b"".join(parts_of(MessageKind.SWEEP, 0, round(STAMP_S * 1e9), payload, 2**26)))
            (frame,) = wait(1)
            vehicle.close()
            again.close()
    assert frame.points_m.tolist() == measured(0).points_m.tolist()
    assert complaints.count >= 1


def datagrams(index: int, message: int | None = None) -> list[bytes]:
    payload = sweep_payload(measured(index), PointEncoding.EXACT)
    stamp_ns = round((STAMP_S + 0.1 * index) * 1e9)
    return list(parts_of(MessageKind.SWEEP, index if message is None else message, stamp_ns, payload, DATAGRAM_BYTES))


def joined(parts: Parts, sent: list[bytes]) -> list[Head]:
    return [whole[0] for datagram in sent if (whole := parts.add("sensor", datagram)) is not None]


def test_a_lost_part_costs_its_own_sweep_alone() -> None:
    complaints = Complaints()
    parts = Parts(complaints)
    sent = [d for i in range(4) for j, d in enumerate(datagrams(i)) if (i, j) != (1, 3)]
    assert [head.message for head in joined(parts, sent)] == [0, 2, 3]
    assert complaints.count == 1


def test_parts_may_come_twice_and_in_any_order() -> None:
    complaints = Complaints()
    sent = datagrams(0) * 2
    random.Random(1).shuffle(sent)  # noqa: S311
    assert [head.message for head in joined(Parts(complaints), sent)] == [0]
    assert complaints.count == 0


def test_message_numbers_begin_again_after_the_largest() -> None:
    complaints = Complaints()
    sent = [d for i, number in enumerate([2**32 - 2, 2**32 - 1, 0, 1]) for d in datagrams(i, number)]
    assert len(joined(Parts(complaints), sent)) == 4
    assert complaints.count == 0


def test_what_waits_for_parts_is_bounded_however_many_begin() -> None:
    complaints = Complaints()
    parts = Parts(complaints)
    for number in range(500):
        assert parts.add("sensor", datagrams(0, number)[0]) is None
    assert len(parts._waiting) <= MOST_WAITING
    assert parts._size <= MOST_WAITING * DATAGRAM_BYTES
    assert complaints.count == 500 - MOST_WAITING


def test_parts_that_contradict_each_other_are_left_out() -> None:
    complaints = Complaints()
    parts = Parts(complaints)
    parts.add("sensor", datagrams(0, 7)[0])
    parts.add("sensor", datagrams(1, 7)[1])
    assert complaints.count == 1


def test_a_clock_that_went_back_for_good_ends_the_drive_with_a_reason() -> None:
    source, port, _ = udp()
    sending = UdpSending("127.0.0.1", port)
    sender = LiveSender(sending)
    points = np.ones((3, 3), np.float32)
    with listened_to(source) as wait:
        sender.send(LidarFrame(STAMP_S, points))
        wait(1)
        for index in range(live_source.CLOCK_WENT_BACK):
            sender.send(LidarFrame(STAMP_S - 3600 + index, points))
        with pytest.raises(SourceError, match="clock went back"):
            wait(2)
    sending.close()


def test_an_address_in_use_or_without_sense_is_refused() -> None:
    for address in ("udp://127.0.0.1", "udp://:70000", "http://host:80", "tcp://host:1/path", "tcp://:9", "://"):
        with pytest.raises(SourceError, match="expected udp://host:port or tcp://host:port"):
            open_source(address)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(SourceError, match="cannot listen there"):
            open_source(f"udp://127.0.0.1:{taken.getsockname()[1]}")


@given(st.binary(max_size=100), st.integers(0, 255))
def test_any_payload_gives_readings_or_a_clear_error(payload: bytes, kind: int) -> None:
    try:
        readings = decode_payload(kind, round(STAMP_S * 1e9), payload)
    except SourceError:
        return
    assert all(math.isfinite(reading.stamp_s) for reading in readings)


@given(st.binary(max_size=60))
def test_any_bytes_are_a_header_or_none(data: bytes) -> None:
    head = parse_head(data)
    assert head is None or head.part < head.parts


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 12)), max_size=60))
def test_whatever_is_lost_doubled_or_swapped_a_message_comes_whole_and_once(order: list[tuple[int, int]]) -> None:
    parts = Parts(Complaints())
    sent = [datagrams(i) for i in range(4)]
    found = {}
    for message, part in order:
        whole = parts.add("sensor", sent[message][part % len(sent[message])])
        if whole is not None:
            assert whole[0].message not in found
            found[whole[0].message] = whole[1]
    for message, payload in found.items():
        assert payload == sweep_payload(measured(message), PointEncoding.EXACT)


@given(st.lists(st.tuples(st.integers(0, 60), st.binary(min_size=1, max_size=6), st.booleans()), max_size=20))
def test_whatever_datagrams_come_what_waits_is_bounded(changes: list[tuple[int, bytes, bool]]) -> None:
    parts = Parts(Complaints())
    for number, (at, data, mend) in enumerate(changes):
        datagram = bytearray(datagrams(0, number)[0])
        datagram[at : at + len(data)] = data
        if mend:
            datagram[28:32] = zlib.crc32(datagram[HEADER.size :]).to_bytes(4, "little")
        parts.add("somebody", bytes(datagram))
        assert len(parts._waiting) <= MOST_WAITING
        assert parts._size == sum(waiting.size for waiting in parts._waiting.values())


def test_points_that_were_not_measured_or_lie_too_far_are_nan_in_small_points() -> None:
    frame = LidarFrame(STAMP_S, np.array([[1, 2, 3], [np.nan, 0, 0], [400, 0, 0]], np.float32))
    (sweep,) = decode_payload(MessageKind.SWEEP, round(STAMP_S * 1e9), sweep_payload(frame, PointEncoding.SMALL))
    assert np.isnan(sweep.points_m).all(axis=1).tolist() == [False, True, True]
    assert (sweep.ring, sweep.point_time_s) == (None, None)
