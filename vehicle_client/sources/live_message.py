"""The messages of live sensors, byte by byte as in docs/sources.md: a header, and a payload by kind.

All numbers are little-endian. Over TCP a message is one part; over UDP it is cut into parts, a datagram each.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from vehicle_client.sources.checked_values import checked_fix, checked_pose, finite
from vehicle_client.sources.frame import LidarFrame, Motion, SourceError
from vehicle_client.sources.pictures import decode_picture
from vehicle_client.sources.point_fields import MOST_POINTS
from vehicle_client.sources.readings import Odometry, Picture, Reading, Steering

MAGIC, VERSION = b"HDUP", 1
HEADER = struct.Struct("<4sBBHHHIIQI")

LARGEST_PAYLOAD = 64 * 2**20
"""Two million points of 24 bytes and a raw 4K picture fit."""

SWEEP_HEADER = struct.Struct("<BBHI")
FIX = struct.Struct("<dddfffff")
MOTION = struct.Struct("<fff")
ODOMETRY = struct.Struct("<ddddddd")

EXACT_POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("time", "<f4"), ("ring", "<u2"), ("pad", "<u2")]
)
SMALL_POINT = np.dtype([("x", "<i2"), ("y", "<i2"), ("z", "<i2"), ("intensity", "u1"), ("ring", "u1"), ("time", "<u2")])

STEP_M = 0.004
"""Of the small point's coordinates: 131 m of reach, and a third of a LiDAR's own noise."""

STEP_S = 1e-5
"""Of the small point's time before the stamp: 0.65 s of reach, 0.3 mm at 30 m/s."""

NOT_MEASURED, NO_RING, NO_SMALL_RING, NO_TIME = -32768, 65535, 255, 65535


class MessageKind(IntEnum):
    """What a payload holds."""

    SWEEP = 1
    FIX = 2
    MOTION = 3
    IMAGE = 4
    ODOMETRY = 5


class PointEncoding(IntEnum):
    """How the points of a sweep are written: 24 exact bytes each, or 10 in steps of 4 mm."""

    EXACT = 1
    SMALL = 2


@dataclass(frozen=True, slots=True)
class Head:
    """The header of a part: `message` counts up for each message of a sender, `length` is that of this payload."""

    kind: int
    part: int
    parts: int
    message: int
    length: int
    stamp_ns: int
    crc: int


def parse_head(data: bytes | bytearray | memoryview) -> Head | None:
    """The header at the start of some bytes; None if it is none that can be right."""
    if len(data) < HEADER.size:
        return None
    magic, version, kind, part, parts, reserved, message, length, stamp_ns, crc = HEADER.unpack_from(data)
    if magic != MAGIC or version != VERSION or reserved or part >= parts or length > LARGEST_PAYLOAD:
        return None
    return Head(kind, part, parts, message, length, stamp_ns, crc)


def parts_of(kind: MessageKind, message: int, stamp_ns: int, payload: bytes, part_bytes: int) -> Iterator[bytes]:
    """A message cut into parts of at most so many bytes of payload, each with its header."""
    starts = range(0, max(len(payload), 1), part_bytes)
    if len(starts) > 0xFFFF or len(payload) > LARGEST_PAYLOAD:
        raise ValueError(f"a payload of {len(payload)} bytes is too large")
    for part, start in enumerate(starts):
        piece = payload[start : start + part_bytes]
        crc = zlib.crc32(piece)
        number = message % 2**32
        yield HEADER.pack(MAGIC, VERSION, kind, part, len(starts), 0, number, len(piece), stamp_ns, crc) + piece


def sweep_payload(frame: LidarFrame, encoding: PointEncoding) -> bytes:
    """Points, intensity, ring and time of a frame."""
    count = len(frame.points_m)
    points = np.zeros(count, dtype=EXACT_POINT if encoding is PointEncoding.EXACT else SMALL_POINT)
    times = frame.point_time_s
    if encoding is PointEncoding.EXACT:
        points["x"], points["y"], points["z"] = frame.points_m.T
        points["time"] = np.nan if times is None else times
        points["ring"] = NO_RING if frame.ring is None else frame.ring
        points["intensity"] = 0 if frame.intensity is None else frame.intensity
    else:
        steps = np.rint(frame.points_m / STEP_M)
        measured = (np.abs(steps) < -NOT_MEASURED).all(axis=1)  # false for NaN
        points["x"], points["y"], points["z"] = np.where(measured[:, None], steps, NOT_MEASURED).T
        points["time"] = NO_TIME if times is None else np.clip(np.rint(times / -STEP_S), 0, NO_TIME - 1)
        points["ring"] = NO_SMALL_RING if frame.ring is None else np.minimum(frame.ring, NO_SMALL_RING)
        points["intensity"] = 0 if frame.intensity is None else np.clip(frame.intensity, 0, 255)
    return SWEEP_HEADER.pack(encoding, 0, 0, count) + points.tobytes()


def decode_payload(kind: int, stamp_ns: int, payload: bytes | bytearray) -> list[Reading]:
    """What a whole message says; `SourceError` where it makes no sense."""
    read = READERS.get(kind)
    if read is None:
        raise SourceError(f"messages of kind {kind} are not known")
    try:
        return read(stamp_ns / 1e9, bytes(payload))
    except struct.error as error:
        raise SourceError(f"a {MessageKind(kind).name.lower()} of {len(payload)} bytes: {error}") from error


def _sweep(stamp_s: float, payload: bytes) -> list[Reading]:
    encoding, _, _, count = SWEEP_HEADER.unpack_from(payload)
    kind = {PointEncoding.EXACT: EXACT_POINT, PointEncoding.SMALL: SMALL_POINT}.get(encoding)
    if kind is None:
        raise SourceError(f"points encoded as {encoding} are not known")
    if not 0 < count <= MOST_POINTS or len(payload) != SWEEP_HEADER.size + count * kind.itemsize:
        raise SourceError(f"a sweep announces {count} points of {kind.itemsize} bytes, and has {len(payload)} bytes")
    points = np.frombuffer(payload, dtype=kind, offset=SWEEP_HEADER.size)
    return [_exact(stamp_s, points) if kind is EXACT_POINT else _small(stamp_s, points)]


def _exact(stamp_s: float, points: np.ndarray) -> LidarFrame:
    timed, ringed = np.isfinite(points["time"]).all(), (points["ring"] != NO_RING).all()
    return LidarFrame(
        stamp_s,
        np.stack([points[axis] for axis in "xyz"], axis=1).astype(np.float32),
        intensity=points["intensity"].astype(np.float32),
        ring=points["ring"].astype(np.uint16) if ringed else None,
        point_time_s=points["time"].astype(np.float32) if timed else None,
    )


def _small(stamp_s: float, points: np.ndarray) -> LidarFrame:
    steps = np.stack([points[axis] for axis in "xyz"], axis=1)
    points_m = (steps * np.float32(STEP_M)).astype(np.float32)
    points_m[(steps == NOT_MEASURED).any(axis=1)] = np.nan
    timed, ringed = (points["time"] != NO_TIME).all(), (points["ring"] != NO_SMALL_RING).all()
    return LidarFrame(
        stamp_s,
        points_m,
        intensity=points["intensity"].astype(np.float32),
        ring=points["ring"].astype(np.uint16) if ringed else None,
        point_time_s=(points["time"] * np.float32(-STEP_S)).astype(np.float32) if timed else None,
    )


def _fix(stamp_s: float, payload: bytes) -> list[Reading]:
    latitude, longitude, altitude, sd_m, altitude_sd_m, *said = FIX.unpack(payload)
    covariance = [sd_m**2, 0, 0, 0, sd_m**2, 0, 0, 0, altitude_sd_m**2]
    fix = checked_fix(stamp_s, (latitude, longitude, altitude), covariance)
    heading_rad, course_rad, speed_mps = (None if math.isnan(value) else finite(value) for value in said)
    return [replace(fix, heading_rad=heading_rad, course_rad=course_rad, speed_mps=speed_mps)]


def _motion(stamp_s: float, payload: bytes) -> list[Reading]:
    speed, rate, steering = (None if math.isnan(value) else finite(value) for value in MOTION.unpack(payload))
    readings: list[Reading] = [] if steering is None else [Steering(stamp_s, steering)]
    return readings if speed is None and rate is None else [Motion(stamp_s, speed, rate), *readings]


def _image(stamp_s: float, payload: bytes) -> list[Reading]:
    return [Picture(stamp_s, lambda: decode_picture(payload))]


def _odometry(stamp_s: float, payload: bytes) -> list[Reading]:
    values = ODOMETRY.unpack(payload)
    return [Odometry(stamp_s, checked_pose(values[:3], values[3:]))]


READERS: Mapping[int, Callable[[float, bytes], list[Reading]]] = {
    MessageKind.SWEEP: _sweep,
    MessageKind.FIX: _fix,
    MessageKind.MOTION: _motion,
    MessageKind.IMAGE: _image,
    MessageKind.ODOMETRY: _odometry,
}
