"""Everything of a frame at its stamp: clocks' known offsets taken out, pictures too old for an overlay left out."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from vehicle_client.sources.frame import GnssFix, LidarFrame, Motion

IMAGE_LASTS_S = 0.1
"""A picture farther than this from its sweep is not drawn upon: a camera of 10 Hz gives a nearer one, and carrying the
overlay over a longer time would show what the driver no longer sees."""


@dataclass(frozen=True, slots=True)
class SensorDelays:
    """How much later than its measurement each sensor's reading is stamped, seconds: measured once a vehicle.

    `gnss_s` may be None: nobody has measured it.
    """

    gnss_s: float | None = None
    camera_s: float = 0.0
    motion_s: float = 0.0


def aligned(frame: LidarFrame, delays: SensorDelays) -> LidarFrame:
    """The frame with the stamps of fix, picture and motions by the sweep's clock; a picture of another time left out.

    A reading without a stamp of its own has the frame's.
    """
    gnss_s = delays.gnss_s or 0.0
    image_stamp_s = _earlier(frame.image_stamp_s, frame.stamp_s, delays.camera_s)
    fresh = abs(image_stamp_s - frame.stamp_s) <= IMAGE_LASTS_S
    return replace(
        frame,
        gnss=None if frame.gnss is None else _fix_at(frame.gnss, frame.stamp_s, gnss_s),
        earlier_fixes=tuple(_fix_at(fix, frame.stamp_s, gnss_s) for fix in frame.earlier_fixes),
        image=frame.image if fresh else None,
        image_stamp_s=image_stamp_s if fresh and frame.image is not None else None,
        motions=tuple(_motion_at(motion, delays.motion_s) for motion in frame.motions),
    )


def _earlier(stamp_s: float | None, frame_s: float, delay_s: float) -> float:
    known = frame_s if stamp_s is None or not math.isfinite(stamp_s) else stamp_s
    return known - delay_s


def _fix_at(fix: GnssFix, frame_s: float, delay_s: float) -> GnssFix:
    return fix if delay_s == 0 else replace(fix, stamp_s=_earlier(fix.stamp_s, frame_s, delay_s))


def _motion_at(motion: Motion, delay_s: float) -> Motion:
    return motion if delay_s == 0 else replace(motion, stamp_s=motion.stamp_s - delay_s)
