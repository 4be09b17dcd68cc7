"""Pictures from PNG and JPEG: whole ones alone, and none that would fill the memory."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vehicle_client.sources.frame import SourceError

MOST_PIXELS = 50_000_000
"""Six times 4K. A PNG of some kilobytes can announce a hundred times as many, all black."""

PNG_START, PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"
JPEG_START, JPEG_END = b"\xff\xd8\xff", b"\xff\xd9"

ENDINGS = (".png", ".jpg", ".jpeg")


def read_picture(path: Path) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 BGR of a PNG or JPEG file; `SourceError` where it is not whole."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror}") from error
    try:
        return decode_picture(data)
    except SourceError as error:
        raise SourceError(f"{path}: {error}") from error


def decode_picture(data: bytes) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 BGR of the bytes of a PNG or JPEG; `SourceError` where they are not whole.

    OpenCV would fill what is missing with grey, so the end is looked for first.
    """
    size = _png_size(data) or _jpeg_size(data)
    if size is None:
        raise SourceError("expected a whole PNG or JPEG picture")
    if size[0] * size[1] > MOST_PIXELS:
        raise SourceError(f"a picture of {size[0]} x {size[1]} pixels is more than a camera of a car has")
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error:
        image = None
    if image is None:
        raise SourceError("expected a whole PNG or JPEG picture")
    return np.asarray(image, dtype=np.uint8)


def _png_size(data: bytes) -> tuple[int, int] | None:
    """Width and height of a whole PNG (ISO/IEC 15948, 11.2.1: they stand after the name of the first chunk)."""
    if not data.startswith(PNG_START) or not data.endswith(PNG_END) or len(data) < 33:
        return None
    width, height = struct.unpack_from(">II", data, 16)
    return int(width), int(height)


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Width and height of a whole JPEG (ITU-T T.81, B.1.1.3 and B.2.2: in the segment that begins the frame)."""
    if not data.startswith(JPEG_START) or not data.rstrip(b"\0").endswith(JPEG_END):
        return None
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            return int.from_bytes(data[at + 7 : at + 9], "big"), int.from_bytes(data[at + 5 : at + 7], "big")
        at += 2 + length
    return None
