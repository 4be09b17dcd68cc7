"""The one value that every source yields, whatever it reads."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contract.geometry import LatLon


class SourceError(ValueError):
    """A file or stream cannot be read; the message says what was expected."""


@dataclass(frozen=True, slots=True)
class GnssFix:
    """A satellite fix of the vehicle frame's origin; `sd_m` is the horizontal standard deviation of each axis."""

    position: LatLon
    altitude_m: float
    heading_rad: float
    """Clockwise from north, from a dual antenna or an inertial unit."""
    sd_m: float
    altitude_sd_m: float


@dataclass(frozen=True, slots=True)
class LidarFrame:
    """One sweep: `points_m` (N, 3) float32 metres in the `sensor` frame (REP 103: x forward, y left, z up).

    `stamp_s` is Unix time. Optional: `intensity` and `ring` (N,), `image` (H, W, 3) uint8 BGR of the forward camera,
    `odom_from_vehicle` (4, 4) from odometry, `gnss`, `steering_rad` of the front wheels (positive left), `speed_mps`.
    """

    stamp_s: float
    points_m: NDArray[np.float32]
    intensity: NDArray[np.float32] | None = None
    ring: NDArray[np.uint16] | None = None
    image: NDArray[np.uint8] | None = None
    odom_from_vehicle: NDArray[np.float64] | None = None
    gnss: GnssFix | None = None
    steering_rad: float = 0.0
    speed_mps: float | None = None


class Source(Protocol):
    """A drive: its number of sweeps, and the sweeps in the order of time."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[LidarFrame]: ...
