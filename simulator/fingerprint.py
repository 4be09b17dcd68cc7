"""Plans in plain values, so that two of them can be compared, and a file can say what it was made from."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path

import numpy as np

FINGERPRINT_DIGITS = 16
"""64 bits: two different scans of the same digits are not met by chance."""


def plain(value: object) -> object:
    """A value as JSON has it: dataclasses as mappings by field, enumerations by name, all else by a fingerprint."""
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, np.ndarray):
        return _fingerprint(f"{value.dtype.str} {value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    return _fingerprint(pickle.dumps(value, protocol=5))


def _fingerprint(content: bytes) -> str:
    return f"sha256:{hashlib.sha256(content).hexdigest()[:FINGERPRINT_DIGITS]}"
