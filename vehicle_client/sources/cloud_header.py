"""What the header of a PLY, PCD or LAS file announces, held against what the file contains.

Open3D fills the points that a truncated file lacks with zeros, and laspy reads as many records as a corrupt header
announces, be it billions: so the file is measured before it is read.
"""

from __future__ import annotations

import itertools
import struct
from pathlib import Path

from vehicle_client.sources.frame import SourceError

HEADER_BYTES = 64 * 1024
"""Headers of some kilobytes exist, with many properties and comments; a longer one is not a header."""

MOST_POINTS = 20_000_000
"""A hundred times what the densest LiDAR measures in a turn."""

# ASPRS LAS 1.4 R15, tables 3, 6 and 8: offsets of counts in the public header block, least bytes of a record.
LAS_HEADER_BYTES, LAS_VLR_COUNT, LAS_POINT_COUNT, LAS_EVLR_COUNT, LAS_POINT_COUNT_64 = 227, 100, 107, 243, 247
LAS_VLR_BYTES, LAS_EVLR_BYTES = 54, 60
LAS_POINTS_START = 96

# LASzip's record: user id, then 36 bytes to its data, in which the chunk size stands 12 bytes after the start.
LASZIP_RECORD, LASZIP_CHUNK_POINTS, LASZIP_VARYING = b"laszip encoded\0\0", 16 + 36 + 12, 0xFFFF_FFFF

PLY_TYPE_BYTES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "float", "int32", "uint32", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}


def check_announced_points(path: Path) -> int:
    """Number of points that a PLY or PCD file announces; `SourceError` where its body is too short to hold them."""
    data = path.read_bytes()
    words = [line.decode("ascii", "replace").split() for line in data[:HEADER_BYTES].split(b"\n")]
    is_ply = path.suffix.lower() == ".ply"
    last = next((i for i, line in enumerate(words) if _ends_header(line, is_ply)), None)
    count, point_bytes = _ply_points(words[:last]) if is_ply else _pcd_points(words[:last])
    if last is None or count is None:
        raise SourceError(f"{path}: expected a header with {'element vertex N' if is_ply else 'POINTS N and DATA'}")
    body = data.split(b"\n", last + 1)[-1]
    is_text = ["format", "ascii", "1.0"] in words[:last] or words[last] == ["DATA", "ascii"]
    there = len(body.splitlines()) if is_text else len(body) // max(point_bytes, 1)
    if count > MOST_POINTS:
        raise SourceError(f"{path}: the header announces {count} points, more than a sweep can hold")
    if there < count and words[last] != ["DATA", "binary_compressed"]:
        raise SourceError(f"{path}: the header announces {count} points, the file ends after {there}")
    return count


def check_las_header(path: Path) -> int:
    """Number of points that a LAS or LAZ file announces; `SourceError` where it cannot hold what it announces."""
    data = path.read_bytes()
    if data[:4] != b"LASF" or len(data) < LAS_HEADER_BYTES:
        raise SourceError(f"{path}: expected a LAS or LAZ file, which begins with LASF and {LAS_HEADER_BYTES} bytes")
    (records,) = struct.unpack_from("<I", data, LAS_VLR_COUNT)
    (points,) = struct.unpack_from("<I", data, LAS_POINT_COUNT)
    extended = 0
    if data[25] >= 4 and len(data) >= LAS_POINT_COUNT_64 + 8:
        (extended,) = struct.unpack_from("<I", data, LAS_EVLR_COUNT)
        (points,) = struct.unpack_from("<Q", data, LAS_POINT_COUNT_64)
    if records * LAS_VLR_BYTES + extended * LAS_EVLR_BYTES > len(data) or points > MOST_POINTS:
        raise SourceError(f"{path}: the header announces {points} points and {records + extended} records: not a sweep")
    _check_laszip_chunks(path, data, points)
    return int(points)


def _check_laszip_chunks(path: Path, data: bytes, points: int) -> None:
    """Refuse compressed points in more or larger chunks than there are points: lazrs would allocate them and abort."""
    record = data.find(LASZIP_RECORD)
    if record < 0:
        return
    (start,) = struct.unpack_from("<I", data, LAS_POINTS_START)
    try:
        (chunk_points,) = struct.unpack_from("<I", data, record + LASZIP_CHUNK_POINTS)
        (table,) = struct.unpack_from("<q", data, start)
        (chunks,) = struct.unpack_from("<I", data, table + 4) if table >= 0 else (0,)
    except struct.error as error:
        raise SourceError(f"{path}: expected a whole LAZ file: {error}") from error
    varying = chunk_points == LASZIP_VARYING
    if chunks > points + 1 or (chunk_points > MOST_POINTS and not varying):
        raise SourceError(f"{path}: the LAZ file announces {chunks} chunks of {chunk_points} points: corrupt")


def _ends_header(line: list[str], is_ply: bool) -> bool:
    return line == ["end_header"] if is_ply else line[:1] == ["DATA"]


def _ply_points(header: list[list[str]]) -> tuple[int | None, int]:
    """Number of vertices (None without), and bytes of one in a binary body."""
    elements = [i for i, line in enumerate(header) if line[:1] == ["element"]] + [len(header)]
    for first, end in itertools.pairwise(elements):
        if header[first][1:2] == ["vertex"] and header[first][-1].isdigit():
            properties = [line[1] for line in header[first + 1 : end] if line[:1] == ["property"] and len(line) == 3]
            return int(header[first][-1]), sum(PLY_TYPE_BYTES.get(name, 0) for name in properties)
    return None, 0


def _pcd_points(header: list[list[str]]) -> tuple[int | None, int]:
    """Number of points (None without), and bytes of one in a binary body."""
    fields = {line[0]: line[1:] for line in header if line}
    numbers = {
        name: [int(word) for word in fields.get(name, []) if word.isdigit()] for name in ("POINTS", "SIZE", "COUNT")
    }
    if len(numbers["POINTS"]) != 1:
        return None, 0
    counts = numbers["COUNT"] or [1] * len(numbers["SIZE"])
    return numbers["POINTS"][0], sum(size * count for size, count in zip(numbers["SIZE"], counts, strict=False))
