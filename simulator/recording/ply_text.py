"""ASCII PLY files as CARLA saves them (`carla::pointcloud::PointCloudIO`): four decimals, one point a line."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

DECIMALS = 4
"""CARLA's `std::setprecision(4)`: 0.1 mm."""

LARGEST_M = 1e9
"""Values are written through 64-bit integers of 0.1 mm; no coordinate of a sensor comes near."""

LIDAR_PROPERTIES = ("float32 x", "float32 y", "float32 z", "float32 I")
SEMANTIC_PROPERTIES = ("float32 x", "float32 y", "float32 z", "float32 CosAngle", "uint32 ObjIdx", "uint32 ObjTag")


def ply_text(
    properties: tuple[str, ...], decimals: NDArray[np.float32], whole: NDArray[np.uint32] | None = None
) -> bytes:
    """The file of N points: `decimals` (N, F) with four decimals each, then `whole` (N, W) numbers without.

    Rounding is that of C's printf: the float32 times 10^4 is exact in float64. `ValueError` for values that are not
    finite or too large for a sensor.
    """
    whole = np.zeros((len(decimals), 0), dtype=np.uint32) if whole is None else whole
    if len(properties) != decimals.shape[1] + whole.shape[1] or len(decimals) != len(whole):
        raise ValueError(
            f"{len(properties)} properties do not fit {decimals.shape} decimal and {whole.shape} whole numbers"
        )
    if not (np.abs(decimals) < LARGEST_M).all():
        raise ValueError("a point that is not finite cannot be written to a PLY file")
    header = ["ply", "format ascii 1.0", f"element vertex {len(decimals)}"]
    header += [*(f"property {name}" for name in properties), "end_header", ""]
    return "\n".join(header).encode("ascii") + _lines(decimals, whole)


def _lines(decimals: NDArray[np.float32], whole: NDArray[np.uint32]) -> bytes:
    ticks = np.rint(decimals.astype(np.float64) * 10**DECIMALS).astype(np.int64)
    signs = np.signbit(decimals)
    line_bytes = 16 * decimals.shape[1] + 11 * whole.shape[1]
    buffer = np.empty(len(decimals) * line_bytes, dtype=np.uint8)
    return buffer[: _format(ticks, signs, whole, buffer)].tobytes()


@njit(cache=True, nogil=True)
def _format(ticks: Any, signs: Any, whole: Any, buffer: Any) -> int:
    """Write all lines and say where they end. One thread: a parallel kernel would not survive a fork."""
    end = 0
    for row in range(len(ticks)):
        for column in range(ticks.shape[1]):
            end = _put_decimal(buffer, end, ticks[row, column], signs[row, column])
        for column in range(whole.shape[1]):
            end = _put_whole(buffer, end, np.int64(whole[row, column]), 1)
        buffer[end - 1] = ord("\n")
    return end


@njit(cache=True, nogil=True)
def _put_decimal(line: Any, end: int, ticks: int, negative: bool) -> int:
    """Write ticks of 10^-4 as a decimal number and a space; CARLA writes -0.0000 as well."""
    if negative:
        line[end] = ord("-")
        end += 1
    magnitude = abs(ticks)
    end = _put_whole(line, end, magnitude // 10**DECIMALS, 1)
    line[end - 1] = ord(".")
    return _put_whole(line, end, magnitude % 10**DECIMALS, DECIMALS)  # type: ignore[no-any-return]  # numba has no types


@njit(cache=True, nogil=True)
def _put_whole(line: Any, end: int, number: int, digits: int) -> int:
    """Write a whole number with at least so many digits, and a space."""
    limit = 10**digits
    while number >= limit:
        limit *= 10
        digits += 1
    for place in range(end + digits - 1, end - 1, -1):
        line[place] = ord("0") + number % 10
        number //= 10
    line[end + digits] = ord(" ")
    return end + digits + 1
