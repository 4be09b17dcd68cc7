"""A drive as if it were now: servers refuse what was seen days ago, and a recording is to be tried against one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from vehicle_client.sources.frame import GnssFix, LidarFrame


def begun_at(frames: Iterable[LidarFrame], start_s: float) -> Iterator[LidarFrame]:
    """The frames with all stamps moved so that the first sweep is of `start_s`, Unix time."""
    by_s: float | None = None
    for frame in frames:
        by_s = start_s - frame.stamp_s if by_s is None else by_s
        yield shifted(frame, by_s)


def shifted(frame: LidarFrame, by_s: float) -> LidarFrame:
    """The frame with all that carries a stamp moved in time."""
    return replace(
        frame,
        stamp_s=frame.stamp_s + by_s,
        gnss=None if frame.gnss is None else _shifted_fix(frame.gnss, by_s),
        earlier_fixes=tuple(_shifted_fix(fix, by_s) for fix in frame.earlier_fixes),
        image_stamp_s=None if frame.image_stamp_s is None else frame.image_stamp_s + by_s,
        motions=tuple(replace(motion, stamp_s=motion.stamp_s + by_s) for motion in frame.motions),
    )


def _shifted_fix(fix: GnssFix, by_s: float) -> GnssFix:
    return fix if fix.stamp_s is None else replace(fix, stamp_s=fix.stamp_s + by_s)
