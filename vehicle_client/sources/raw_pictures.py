"""Pictures that were recorded as they came from the camera, in the encodings of ROS and Foxglove."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from vehicle_client.sources.frame import SourceError
from vehicle_client.sources.pictures import MOST_PIXELS

BYTES_PER_PIXEL = {"bgr8": 3, "rgb8": 3, "8UC3": 3, "bgra8": 4, "rgba8": 4, "mono8": 1, "8UC1": 1} | dict.fromkeys(
    ("uyvy", "yuv422", "yuyv", "yuv422_yuy2"), 2
)

TO_BGR = {
    "rgb8": cv2.COLOR_RGB2BGR,
    "bgra8": cv2.COLOR_BGRA2BGR,
    "rgba8": cv2.COLOR_RGBA2BGR,
    "mono8": cv2.COLOR_GRAY2BGR,
    "8UC1": cv2.COLOR_GRAY2BGR,
    "uyvy": cv2.COLOR_YUV2BGR_UYVY,
    "yuv422": cv2.COLOR_YUV2BGR_UYVY,
    "yuyv": cv2.COLOR_YUV2BGR_YUYV,
    "yuv422_yuy2": cv2.COLOR_YUV2BGR_YUYV,
    # OpenCV names a pattern by its second row, ROS by its first.
    "bayer_rggb8": cv2.COLOR_BayerBG2BGR,
    "bayer_bggr8": cv2.COLOR_BayerRG2BGR,
    "bayer_gbrg8": cv2.COLOR_BayerGR2BGR,
    "bayer_grbg8": cv2.COLOR_BayerGB2BGR,
}


def raw_picture(
    width: int, height: int, row_bytes: int, encoding: str, data: bytes | NDArray[np.uint8]
) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 BGR; `SourceError` where size and bytes do not agree or the encoding is not known."""
    channels = 1 if encoding.startswith("bayer_") else BYTES_PER_PIXEL.get(encoding)
    if channels is None or (encoding not in TO_BGR and channels != 3):
        raise SourceError(f"pictures encoded as {encoding[:30]!r} cannot be read; expected one of {', '.join(TO_BGR)}")
    pixels = np.frombuffer(data, dtype=np.uint8)
    if not (0 < width * height <= MOST_PIXELS and width * channels <= row_bytes and row_bytes * height == len(pixels)):
        raise SourceError(f"{len(pixels)} bytes are no picture of {width} x {height} pixels, {encoding}")
    rows = pixels.reshape(height, row_bytes)[:, : width * channels]
    image = np.ascontiguousarray(rows.reshape(height, width, channels) if channels > 1 else rows)
    if encoding not in TO_BGR:
        return image
    try:
        return np.asarray(cv2.cvtColor(image, TO_BGR[encoding]), dtype=np.uint8)
    except cv2.error as error:
        raise SourceError(f"a picture of {width} x {height} pixels cannot be {encoding}") from error
