"""Sensors that exist, and CARLA's default; docs/sensors.md compares them with real scans."""

from __future__ import annotations

import math

import numpy as np

from simulator.sensors.beam import Beam
from simulator.sensors.lidar import Laser, LidarModel
from simulator.sensors.returns import CarlaReturns, MeasuredReturns

# fmt: off
HDL64E_ELEVATIONS_DEG = (
    -25.00, -24.51, -23.97, -23.32, -22.86, -22.44, -21.93, -21.32,
    -20.79, -20.22, -19.74, -19.32, -18.80, -18.32, -17.73, -17.19,
    -16.55, -16.18, -15.66, -15.19, -14.60, -14.05, -13.48, -13.04,
    -12.56, -12.12, -11.60, -10.96, -10.47, -10.06, -9.57, -9.03,
    -8.71, -8.31, -8.06, -7.68, -7.29, -7.00, -6.68, -6.33,
    -5.96, -5.61, -5.25, -4.91, -4.59, -4.22, -3.94, -3.54,
    -3.24, -2.87, -2.55, -2.21, -1.83, -1.49, -1.20, -0.80,
    -0.45, -0.09, 0.18, 0.58, 0.87, 1.30, 1.57, 1.94,
)
# fmt: on
"""The cones on which the points of each ring of 16 real scans lie, to 0.01 degrees, from below to above."""

HDL64E_LOWER_BLOCK = 32
"""Lasers of the lower of its two blocks, about 0.5 degrees apart; those of the upper are about 0.35 apart."""


def _hdl64e_lasers() -> tuple[Laser, ...]:
    """Heights as the same scans show them: straight lines over the elevation in each block, within 1 mm.

    Each ring's range is off by a constant: against a smooth road the real rings lie 30 mm (1 sigma) about their mean,
    the same in every frame. The constants themselves are drawn once, as another unit would have others.
    """
    elevation = np.array(HDL64E_ELEVATIONS_DEG)
    lower, upper = 0.1317 + 0.000626 * elevation, 0.2070 + 0.00103 * elevation
    height = np.where(np.arange(len(elevation)) < HDL64E_LOWER_BLOCK, lower, upper)
    bias = np.random.default_rng(64).normal(0.0, 0.030, len(elevation))
    return tuple(Laser(math.radians(e), float(h), float(b)) for e, h, b in zip(elevation, height, bias, strict=True))


def hdl64e() -> LidarModel:
    """Velodyne HDL-64E as KITTI drives it: 10 Hz, counter-clockwise, 1.73 m above the road (Geiger et al., 2013).

    2160 columns: the mean step of the real scans is 0.1667 degrees; their files end at 80 m. A beam of 2 mrad, pulses
    of 5 ns, which tell two echoes apart by c x 5 ns / 2 = 0.75 m; asphalt to 50 m (HDL-64E manual).
    """
    return LidarModel(
        channels=64,
        upper_elevation_rad=math.radians(HDL64E_ELEVATIONS_DEG[-1]),
        lower_elevation_rad=math.radians(HDL64E_ELEVATIONS_DEG[0]),
        range_m=80.0,
        near_m=0.9,
        points_per_second=2160 * 64 * 10,
        rate_hz=10.0,
        height_m=1.73,
        range_sd_m=0.0075,
        lasers=_hdl64e_lasers(),
        clockwise=False,
        rolling=True,
        beam=Beam(divergence_rad=0.002, echo_separation_m=0.75),
        returns=MeasuredReturns(reach_m=50.0, fluctuation=0.5, gain=2.0),
    )


def _hdl32e_lasers() -> tuple[Laser, ...]:
    """Evenly spaced; rings of the real sweep lie 13 mm (1 sigma) about a smooth road, drawn as for the HDL-64E."""
    bias = np.random.default_rng(32).normal(0.0, 0.013, 32)
    elevation = np.radians(np.linspace(-30.67, 10.67, 32))
    return tuple(Laser(float(e), range_bias_m=float(b)) for e, b in zip(elevation, bias, strict=True))


def hdl32e() -> LidarModel:
    """Velodyne HDL-32E as nuScenes drives it: 20 Hz, clockwise, 1.84 m above the road (Caesar et al., 2020).

    Elevations -30.67 to +10.67 degrees, 1.33 apart; 1084 columns as in its files; 3 mrad, pulses of 5 ns.
    """
    return LidarModel(
        channels=32,
        upper_elevation_rad=math.radians(10.67),
        lower_elevation_rad=math.radians(-30.67),
        range_m=100.0,
        near_m=1.0,
        points_per_second=1084 * 32 * 20,
        rate_hz=20.0,
        height_m=1.84,
        range_sd_m=0.0035,
        lasers=_hdl32e_lasers(),
        rolling=True,
        beam=Beam(divergence_rad=0.003, echo_separation_m=0.75),
        returns=MeasuredReturns(reach_m=40.0, fluctuation=0.5, gain=100 / 255),
    )


def carla_default() -> LidarModel:
    """CARLA 0.9.16's `sensor.lidar.ray_cast` as its documentation states the defaults."""
    return LidarModel(
        channels=32,
        range_m=10.0,
        points_per_second=56_000,
        rate_hz=10.0,
        range_sd_m=0.0,
        returns=CarlaReturns(general_dropoff=0.45, dropoff_intensity_limit=0.8, zero_intensity_dropoff=0.4),
    )


LIDAR_PRESETS = {"paper": LidarModel, "hdl64": hdl64e, "hdl32": hdl32e, "carla": carla_default}
"""The names that configurations use."""
