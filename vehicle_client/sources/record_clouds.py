"""Binary PLY and PCD as records of named fields: Open3D's reader forgets intensity, ring and time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vehicle_client.sources.cloud_header import HEADER_BYTES
from vehicle_client.sources.point_fields import record_type

PLY_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}

PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}

PCD_TYPES = {"F": ("4", "8"), "I": ("1", "2", "4", "8"), "U": ("1", "2", "4", "8")}
"""Sizes that a field of each type may have (https://pointclouds.org/documentation/tutorials/pcd_file_format.html)."""


def read_records(path: Path, count: int) -> NDArray[np.void] | None:
    """The points of a binary file whose header announces so many; None if it is text, compressed or anything else.

    `SourceError` where its fields do not fit its records.
    """
    data = path.read_bytes()
    lines = [line.decode("ascii", "replace").split() for line in data[:HEADER_BYTES].split(b"\n")]
    ended = next((i for i, line in enumerate(lines) if line == ["end_header"] or line[:1] == ["DATA"]), None)
    if ended is None:
        return None
    kind = _ply_record(lines[:ended]) if path.suffix.lower() == ".ply" else _pcd_record(lines[: ended + 1])
    body = data.split(b"\n", ended + 1)[-1]
    if kind is None or len(body) < count * kind.itemsize:
        return None
    return np.frombuffer(body, dtype=kind, count=count)


def _ply_record(header: list[list[str]]) -> np.dtype[np.void] | None:
    """A vertex, if it is the first element and all its properties are numbers."""
    order = next((PLY_ORDERS.get(line[1]) for line in header if line[:1] == ["format"] and len(line) > 1), None)
    elements = [i for i, line in enumerate(header) if line[:1] == ["element"]]
    if order is None or not elements or header[elements[0]][1:2] != ["vertex"]:
        return None
    end = elements[1] if len(elements) > 1 else len(header)
    properties = [line for line in header[elements[0] : end] if line[:1] == ["property"]]
    if any(len(line) != 3 or line[1] not in PLY_TYPES for line in properties):
        return None
    return _record([(name, order + PLY_TYPES[kind], 1) for _, kind, name in properties])


def _pcd_record(header: list[list[str]]) -> np.dtype[np.void] | None:
    """A point of binary data; fields of several values, and those called _, are passed over."""
    said = {line[0]: line[1:] for line in header if line}
    names, sizes, types = (said.get(key, []) for key in ("FIELDS", "SIZE", "TYPE"))
    counts = said.get("COUNT", ["1"] * len(names))
    whole = len(names) == len(sizes) == len(types) == len(counts) and all(c.isdecimal() for c in counts)
    if said.get("DATA") != ["binary"] or not whole:
        return None
    if any(size not in PCD_TYPES.get(kind, ()) for kind, size in zip(types, sizes, strict=True)):
        return None
    kinds = (f"<{kind.lower()}{size}" for kind, size in zip(types, sizes, strict=True))
    return _record(list(zip(names, kinds, map(int, counts), strict=True)))


def _record(fields: list[tuple[str, str, int]]) -> np.dtype[np.void]:
    """The type of a packed record from names, types and numbers of values."""
    named: dict[str, tuple[str, int]] = {}
    offset = 0
    for name, kind, count in fields:
        if count == 1 and name != "_":
            named[name] = (kind, offset)
        offset += np.dtype(kind).itemsize * count
    return record_type(named, offset)
