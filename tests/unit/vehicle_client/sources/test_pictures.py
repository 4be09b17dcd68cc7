from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle_client.sources.frame import SourceError
from vehicle_client.sources.pictures import decode_picture
from vehicle_client.sources.raw_pictures import BYTES_PER_PIXEL, TO_BGR, raw_picture

COLOUR = (30, 120, 220)
"""Blue, green, red."""


def encoded(ending: str) -> bytes:
    return cv2.imencode(ending, np.full((16, 20, 3), COLOUR, np.uint8))[1].tobytes()


@pytest.mark.parametrize("ending", [".png", ".jpg"])
def test_a_whole_picture_is_blue_green_red(ending: str) -> None:
    image = decode_picture(encoded(ending))
    assert image.shape == (16, 20, 3)
    assert image[8, 8].tolist() == pytest.approx(COLOUR, abs=4)


@pytest.mark.parametrize("ending", [".png", ".jpg"])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.98])
def test_a_picture_that_ends_early_is_refused(ending: str, share: float) -> None:
    data = encoded(ending)
    with pytest.raises(SourceError, match="whole"):
        decode_picture(data[: int(len(data) * share)])


def test_a_small_file_that_announces_a_vast_picture_is_refused_before_it_is_made() -> None:
    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", 30_000, 30_000, 8, 2, 0, 0, 0))
    bomb = b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(b"\0" * 10_000)) + chunk(b"IEND", b"")
    with pytest.raises(SourceError, match="30000 x 30000"):
        decode_picture(bomb)


@given(st.sampled_from([".png", ".jpg"]), st.integers(0, 600), st.binary(min_size=1, max_size=10))
def test_corrupt_bytes_give_a_picture_or_a_clear_error(ending: str, at: int, data: bytes) -> None:
    whole = encoded(ending)
    corrupt = whole[:at] + data + whole[at + len(data) :]
    try:
        image = decode_picture(corrupt)
    except SourceError:
        return
    assert image.ndim == 3
    assert image.dtype == np.uint8


@pytest.mark.parametrize("encoding", ["bgr8", "rgb8", "bgra8", "rgba8"])
@pytest.mark.parametrize("padding", [0, 7])
def test_raw_colours_come_in_one_order_and_padding_is_left_out(encoding: str, padding: int) -> None:
    order = [COLOUR["bgr".index(name)] if name != "a" else 255 for name in encoding[:-1]]
    rows = np.zeros((6, 10 * len(order) + padding), np.uint8)
    rows[:, : 10 * len(order)] = np.tile(order, 10)
    image = raw_picture(10, 6, rows.shape[1], encoding, rows.tobytes())
    assert image.shape == (6, 10, 3)
    assert image[3, 3].tolist() == list(COLOUR)


@pytest.mark.parametrize("encoding", ["bayer_rggb8", "bayer_bggr8", "bayer_gbrg8", "bayer_grbg8"])
def test_a_mosaic_becomes_its_colours(encoding: str) -> None:
    first, second = encoding[6:8], encoding[8:10]
    mosaic = np.zeros((16, 16), np.uint8)
    for row, names in enumerate((first, second)):
        for column, name in enumerate(names):
            mosaic[row::2, column::2] = COLOUR["bgr".index(name)]
    image = raw_picture(16, 16, 16, encoding, mosaic.tobytes())
    assert image[8, 8].tolist() == list(COLOUR)


def test_grey_and_yuv_become_grey() -> None:
    assert raw_picture(4, 2, 4, "mono8", b"\x50" * 8)[0, 0].tolist() == [80] * 3
    uyvy = np.tile(np.array([128, 100], np.uint8), 8)
    image = raw_picture(4, 2, 8, "uyvy", uyvy.tobytes())
    assert image.std() == 0


@pytest.mark.parametrize(
    ("width", "height", "row", "encoding", "count"),
    [
        (10, 6, 30, "bgr8", 179),
        (10, 6, 20, "bgr8", 120),
        (10**6, 10**6, 3 * 10**6, "bgr8", 10),
        (0, 0, 0, "mono8", 0),
        (10, 6, 10, "16UC1", 60),
        (3, 2, 6, "uyvy", 12),
    ],
)
def test_sizes_that_do_not_agree_are_refused(width: int, height: int, row: int, encoding: str, count: int) -> None:
    with pytest.raises(SourceError):
        raw_picture(width, height, row, encoding, b"\0" * count)


def test_every_encoding_has_a_size() -> None:
    assert {name for name in TO_BGR if not name.startswith("bayer_")} <= BYTES_PER_PIXEL.keys()
