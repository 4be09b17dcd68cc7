"""What the header of a PLY or PCD file announces, held against what the file contains.

Open3D fills the points that a truncated file lacks with zeros, so the file is measured before it is read.
"""

from __future__ import annotations

import itertools
from pathlib import Path

from vehicle_client.sources.frame import SourceError

HEADER_BYTES = 64 * 1024
"""Headers of some kilobytes exist, with many properties and comments; a longer one is not a header."""

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
    if there < count and words[last] != ["DATA", "binary_compressed"]:
        raise SourceError(f"{path}: the header announces {count} points, the file ends after {there}")
    return count


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
