"""Files whose bytes depend on their content alone, and that are either whole or not there."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import IO, Any

import cv2
import numpy as np
from numpy.typing import NDArray

PNG_SETTINGS = (cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE)
"""Run lengths alone: no larger than zlib's fastest level makes pictures of streets, in 3/4 of its time (measured)."""

JPEG_QUALITY = 90
"""A fifth of the PNG's size, without blocks that an eye would see."""

ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)
"""The earliest time that a ZIP entry can carry; the real one would change the bytes."""


class RecordingError(ValueError):
    """A recording cannot be written as asked; the message says why."""


def write_whole(path: Path, content: bytes) -> None:
    """Put a file in place in one step: under its name there is never half of it."""
    part = path.with_name(path.name + ".part")
    part.write_bytes(content)
    part.replace(path)


def png_bytes(pixels: NDArray[np.uint8]) -> bytes:
    """PNG of a BGR picture (H, W, 3), or of tags (H, W), which go to the red channel as CARLA writes them."""
    if pixels.ndim == 2:
        zeros = np.zeros_like(pixels)
        pixels = np.stack([zeros, zeros, pixels], axis=2)
    made, encoded = cv2.imencode(".png", pixels, PNG_SETTINGS)
    if not made:
        raise RecordingError(f"a picture of shape {pixels.shape} cannot be written as PNG")
    return encoded.tobytes()


def jpeg_bytes(pixels: NDArray[np.uint8]) -> bytes:
    """JPEG of a BGR picture (H, W, 3) that is to be looked at."""
    made, encoded = cv2.imencode(".jpg", pixels, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))
    if not made:
        raise RecordingError(f"a picture of shape {pixels.shape} cannot be written as JPEG")
    return encoded.tobytes()


def npz_bytes(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """NumPy archive of named arrays."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, array in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, np.ascontiguousarray(array), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy", ZIP_EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, content.getvalue(), compresslevel=1)
    return buffer.getvalue()


def json_bytes(value: object) -> bytes:
    """JSON in a form that people can read; NaN and infinity, which JSON does not know, are refused."""
    return (json.dumps(value, indent=1, allow_nan=False, ensure_ascii=False) + "\n").encode()


def csv_line(values: Iterable[float | int]) -> str:
    """A row of numbers, each with the fewest digits that read back as the same number."""
    return ",".join(repr(float(v)) if isinstance(v, float) else str(int(v)) for v in values) + "\n"


class GrowingFiles:
    """Text files that grow by what each frame adds, opened at the first use."""

    def __init__(self) -> None:
        self._open: dict[Path, IO[str]] = {}

    def add(self, path: Path, text: str, before_first: str = "", between: str = "") -> None:
        """Append text: after `before_first` in a new file, else after `between`."""
        file = self._open.get(path)
        if file is None:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = self._open[path] = path.open("x", encoding="ascii", newline="\n")
            file.write(before_first)
        else:
            file.write(between)
        file.write(text)
        file.flush()

    def close(self) -> None:
        """Close all of them."""
        for file in self._open.values():
            file.close()
