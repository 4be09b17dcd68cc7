"""What goes into the detector and what comes out: frozen values, SI units, frames named in `docs/frames.md`."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, StrEnum

from detector.arrays import Float32Array, FloatArray, LabelArray
from detector.road.corridor import Corridor


class ObstacleKind(StrEnum):
    """What an obstacle is: a hole, a rise of the road itself, or a thing that lies on it."""

    POTHOLE = "pothole"
    BUMP = "bump"
    DEBRIS = "debris"

    @property
    def is_negative(self) -> bool:
        """Whether it lies below the road."""
        return self is ObstacleKind.POTHOLE


class PointClass(IntEnum):
    """The classes of a point, in the paper's colours (Section "Obstacle Detection")."""

    UNCLASSIFIED = 0
    """Unclassified, or flat ground off the road."""
    SAFE_ROAD = 1
    """Blue: the road ahead, safe."""
    NEGATIVE = 2
    """Yellow: be aware, below the road."""
    POSITIVE = 3
    """Cyan: hazardous, above the road, in the range of the road."""
    OUTSIDE = 4
    """Purple: dangerous, salient, outside the range of the road."""
    OBSTACLE = 5
    """Red: recognised obstacle on the road."""


@dataclass(frozen=True, slots=True)
class DetectorInput:
    """One sweep and what the vehicle knows about itself.

    `points_m` is (N, 3) float32 in the `sensor` frame (x forward, y left, z up). `sensor_height_m` is the sensor's
    height over the road, or None for a survey: a patch of road without one viewpoint (a surface scan, a depth map),
    whose points cover it densely. `curvature_per_m` is that of the path ahead from steering, positive to the left.
    `odom_from_sensor` is a (4, 4) rigid transform, needed to accumulate sweeps, not to detect in one.
    """

    points_m: Float32Array
    sensor_height_m: float | None
    curvature_per_m: float = 0.0
    odom_from_sensor: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class ShapeDescriptor:
    """Named, versioned numbers of a shape that survive rotation and a change of density."""

    name: str
    version: int
    values: dict[str, float]


@dataclass(frozen=True, slots=True)
class DetectedObstacle:
    """One obstacle, in the frame of the points it was measured from.

    Lengths in metres; `yaw_rad` in [0, pi) is the direction of the length, counter-clockwise from x; `relief_m` is the
    depth below the road or the height above it, never negative. The `*_sd` are 1 sigma, of natural logarithms for
    length, width and area. `centre_covariance_m2` is (2, 2). `view_front` and `view_rear` say from where it was seen.
    `points_m` are at most 512 voxel-thinned points relative to `centre_m`, (M, 3).
    """

    kind: ObstacleKind
    centre_m: FloatArray
    length_m: float
    width_m: float
    yaw_rad: float
    relief_m: float
    volume_m3: float
    confidence: float
    hits: int
    frames: int
    least_range_m: float
    view_front: bool
    view_rear: bool
    ln_length_sd: float
    ln_width_sd: float
    ln_area_sd: float
    relief_sd_m: float
    centre_covariance_m2: FloatArray
    descriptor: ShapeDescriptor
    points_m: Float32Array


@dataclass(frozen=True, slots=True)
class Findings:
    """What a method says of the usable points (M, 3): classes (M,) uint8 (`PointClass`), saliency (M,) in [0, 1],
    residual (M,) to the road surface in metres (NaN where there is none), obstacles in the points' frame, the road's
    corridor where a vehicle drives along one, and whether a road was seen at all."""

    labels: LabelArray
    saliency: FloatArray
    residual_m: FloatArray
    obstacles: tuple[DetectedObstacle, ...]
    corridor: Corridor | None = None
    road_seen: bool = True


@dataclass(frozen=True, slots=True)
class FrameDetection:
    """Result of one sweep: a class (uint8, `PointClass`) and a saliency (float32, [0, 1]) for every input point in
    input order, the residual of each point to the road surface in metres (NaN where there is no surface), the
    obstacles in the `sensor` frame, the corridor they were searched in (None for a survey), and whether a road was
    seen at all: without one, that there is no obstacle says nothing."""

    labels: LabelArray
    saliency: Float32Array
    residual_m: Float32Array
    obstacles: tuple[DetectedObstacle, ...]
    corridor: Corridor | None = None
    road_seen: bool = True
