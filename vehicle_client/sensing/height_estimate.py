"""How high a LiDAR sits, of which nobody has said it: what its first sweeps show of the road."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from detector.errors import DetectorError
from detector.pipeline import estimate_sensor_height
from vehicle_client.sources.frame import LidarFrame

TRIED_FRAMES = 10
"""Sweeps that are enough to find it, where a road is in sight."""


def estimated_height_m(frames: Sequence[LidarFrame]) -> float | None:
    """Metres above the road, the median over sweeps; None if none of them shows it."""
    heights_m = []
    for frame in frames:
        try:
            heights_m.append(estimate_sensor_height(frame.points_m))
        except DetectorError:
            continue
    known_m = [height_m for height_m in heights_m if height_m is not None]
    return float(np.median(known_m)) if known_m else None
