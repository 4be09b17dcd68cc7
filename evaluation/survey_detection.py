"""The one way into the detector for every table of dense clouds: points in metres, and nothing else."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from detector.pipeline import detect
from detector.types import DetectorInput, FrameDetection, PointClass


def detect_survey(points_m: NDArray[np.float64], method: Literal["surface", "saliency"] = "surface") -> FrameDetection:
    """What the detector says of points (N, 3) in metres, z up, with all its parameters as they are."""
    # Half a metre of float32 has a resolution of 30 nm; coordinates of a map would not.
    local = points_m - (np.round(points_m.mean(axis=0)) if len(points_m) else 0.0)
    return detect(DetectorInput(np.ascontiguousarray(local, dtype=np.float32), None), method)


def in_pothole(detection: FrameDetection) -> NDArray[np.bool_]:
    """Points (N,) inside the outline of a recognised hole, not those of things that stand on the road."""
    with np.errstate(invalid="ignore"):
        return np.asarray((detection.labels == PointClass.OBSTACLE) & (detection.residual_m < 0.0))


def below_road(detection: FrameDetection) -> NDArray[np.bool_]:
    """Points (N,) of a recognised hole, and those flagged below the road around one: its apron to the last shallow
    point."""
    return np.asarray(in_pothole(detection) | (detection.labels == PointClass.NEGATIVE))
