"""Points as records of named fields, as ROS, Foxglove and PCD keep them: which field is what, and in which unit."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from vehicle_client.sources.frame import LidarFrame, SourceError

Float32Array = NDArray[np.float32]

MOST_POINTS = 5_000_000
"""Ten times what the densest LiDAR measures in a turn (128 rings of 4,096 columns)."""

INTENSITY_FIELDS = ("intensity", "i", "reflectivity", "reflectance", "scalar_intensity")
RING_FIELDS = ("ring", "channel", "laser_id", "line")
TIME_FIELDS = ("t", "time", "timestamp", "offset_time", "time_offset", "time_stamp", "stamp")
"""Of Ouster, Velodyne, Hesai and RoboSense, Livox, and ours."""

UNITS = (1.0, 1e-3, 1e-6, 1e-9)
"""Seconds of a second, milli-, micro- and nanosecond."""

LONGEST_SWEEP_S = 2.0
"""A turn takes 0.05 to 0.2 s."""

UNIX_TIMES_S = (1e9, 5e9)
"""2001 to 2128."""


def record_type(fields: Mapping[str, tuple[str, int]], record_bytes: int) -> np.dtype[np.void]:
    """The NumPy type of a record from its fields' types and offsets; `SourceError` where they do not fit in it."""
    for name, (kind, offset) in fields.items():
        if offset < 0 or offset + np.dtype(kind).itemsize > record_bytes:
            raise SourceError(f"the field {name} lies outside of the point's {record_bytes} bytes")
    if not 0 < record_bytes <= 4096:
        raise SourceError(f"a point of {record_bytes} bytes is none")
    return np.dtype(
        {
            "names": list(fields),
            "formats": [kind for kind, _ in fields.values()],
            "offsets": [offset for _, offset in fields.values()],
            "itemsize": record_bytes,
        }
    )


def sweep_of(stamp_s: float, records: NDArray[np.void]) -> LidarFrame:
    """The sweep of records with fields x, y, z and, in any order, intensity, ring and time.

    The sweep's stamp becomes the time of its last point, the others count back from it; without times it is `stamp_s`.
    Points that are not finite stay in their place. `SourceError` where there are no points or no coordinates.
    """
    names = {name.lower(): name for name in records.dtype.names or ()}
    if not {"x", "y", "z"} <= names.keys():
        raise SourceError(f"expected points with x, y and z, found {', '.join(names) or 'nothing'}")
    if not 0 < len(records) <= MOST_POINTS:
        raise SourceError(f"{len(records)} points are no sweep")
    points_m = np.stack([_float32(records[names[axis]]) for axis in "xyz"], axis=1)
    if not np.isfinite(points_m).all(axis=1).any():
        raise SourceError(f"none of its {len(points_m)} points is finite")
    found = {
        what: next((records[names[name]] for name in wanted if name in names), None)
        for what, wanted in (("intensity", INTENSITY_FIELDS), ("ring", RING_FIELDS), ("time", TIME_FIELDS))
    }
    times = None if found["time"] is None else seconds_after(stamp_s, found["time"])
    end_s = 0.0 if times is None else float(times.max())
    return LidarFrame(
        stamp_s + end_s,
        points_m,
        intensity=None if found["intensity"] is None else _float32(found["intensity"]),
        ring=None if found["ring"] is None else _rings(found["ring"]),
        point_time_s=None if times is None else (times - end_s).astype(np.float32),
    )


def seconds_after(stamp_s: float, times: NDArray[np.generic]) -> NDArray[np.float64] | None:
    """Seconds of each point after the sweep's stamp, from times in any unit; None where they make no sense.

    The unit is the coarsest in which a sweep takes no longer than 2 s; integers are never seconds. Unix times are told
    by their size. Times that lie nowhere near the stamp are those of a clock that was never set: then the stamp, made
    as the last point came in, is taken for the sweep's end.
    """
    if times.dtype.kind not in "fiu" or not np.isfinite(times).all():
        return None
    numbers = times.astype(np.float64)  # Unix times in nanoseconds keep 0.3 microseconds
    first = float(numbers.min())
    since_first: NDArray[np.float64] = numbers - first
    span = float(since_first.max())
    fitting = [unit for unit in UNITS[times.dtype.kind in "iu" :] if span * unit <= LONGEST_SWEEP_S]
    if span == 0 or not fitting:
        return None
    absolute = next((unit for unit in fitting if UNIX_TIMES_S[0] <= first * unit < UNIX_TIMES_S[1]), None)
    unit = fitting[0] if absolute is None else absolute
    begin_s = first * unit - (0.0 if absolute is None else stamp_s)
    if abs(begin_s) > LONGEST_SWEEP_S:
        begin_s = -span * unit
    return begin_s + since_first * unit


def _rings(values: NDArray[np.generic]) -> NDArray[np.uint16] | None:
    """Whole numbers of rings, None where they are none."""
    numbers = values.astype(np.float64)
    whole = np.isfinite(numbers).all() and ((numbers >= 0) & (numbers < 2**16) & (numbers % 1 == 0)).all()
    return numbers.astype(np.uint16) if whole else None


def _float32(values: NDArray[np.generic]) -> Float32Array:
    """In the machine's float32; what does not fit becomes infinite and counts as not measured."""
    with np.errstate(over="ignore"):
        return values.astype(np.float32)
