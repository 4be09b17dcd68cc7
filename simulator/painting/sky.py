"""Sun, sky and haze at any hour of a day, in linear RGB."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from simulator.painting.texture import Texture, fractal_noise

Float32Array = NDArray[np.float32]

OPTICAL_DEPTH = np.array([0.10, 0.15, 0.26])
"""Of a clear sky straight up, for red, green and blue: what Rayleigh scattering and some dust take."""

SUN_ABOVE_AIR = np.array([2.64, 2.54, 2.38])
SKY_LIGHT = np.array([0.44, 0.50, 0.60])
HAZE = np.array([0.50, 0.60, 0.72])
ZENITH = np.array([0.06, 0.19, 0.48])
CLOUD = np.array([1.05, 1.05, 1.06])
GREY_SKY = np.array([0.74, 0.77, 0.80])
"""What the daylight of a summer's afternoon looks like through a camera set to it."""

REFERENCE_ELEVATION_RAD = math.radians(45.7)


@dataclass(frozen=True, slots=True, eq=False)
class Daylight:
    """The light of a moment: unit direction towards the sun (3,), colours (3,), and how much of the sky is cloud."""

    sun_direction: Float32Array
    sun_light: Float32Array
    sky_light: Float32Array
    haze: Float32Array
    zenith: Float32Array
    cloud: Float32Array
    cloudiness: float

    def sky_colour(self, rays: Float32Array) -> Float32Array:
        """Colour (N, 3) of the sky along unit rays (N, 3)."""
        up = np.maximum(rays[:, 2], np.float32(0.0))
        blend = ((1 - up) ** 3.5)[:, None]
        clear = self.zenith * (1 - blend) + self.haze * blend
        slant = np.maximum(up, np.float32(0.02))
        across, ahead = (rays[:, :2] / slant[:, None] + np.float32(40)).T
        noise = _clouds().smooth(across, ahead)
        cover = np.clip((noise - 0.25 + 2.6 * self.cloudiness) * 0.75, 0, 1) * np.clip(up * 7 - 0.15, 0, 1) * 0.8
        return np.asarray(clear * (1 - cover[:, None]) + self.cloud * cover[:, None], dtype=np.float32)


def daylight(elevation_rad: float, azimuth_rad: float, cloudiness: float = 0.0) -> Daylight:
    """Light of a sun at an elevation above the horizon, at an azimuth counter-clockwise from the street's x.

    `cloudiness` 0 is a fine day, 1 a closed grey sky. Sunlight is dimmed and reddened by the air it crosses (Kasten and
    Young 1989), and the exposure follows the light as a camera's does. ValueError for a sun below 3 degrees: there is
    no street lighting here.
    """
    if not (math.radians(3.0) <= elevation_rad <= math.pi / 2 and 0.0 <= cloudiness <= 1.0):
        raise ValueError("daylight needs a sun 3 to 90 degrees high and a cloudiness from 0 to 1")
    flat = math.cos(elevation_rad)
    towards = np.array([flat * math.cos(azimuth_rad), flat * math.sin(azimuth_rad), math.sin(elevation_rad)])
    sun = SUN_ABOVE_AIR * np.exp(-OPTICAL_DEPTH * _air_mass(elevation_rad)) * (1 - 0.93 * cloudiness)
    height = math.sqrt(math.sin(elevation_rad) / math.sin(REFERENCE_ELEVATION_RAD))
    dusk = np.array([1.0, 0.93, 0.82]) ** max(0.0, _air_mass(elevation_rad) / 1.4 - 1) ** 0.5
    grey = cloudiness * GREY_SKY
    sky, haze, zenith = ((1 - cloudiness) * colour * height + grey * height for colour in (SKY_LIGHT, HAZE, ZENITH))
    exposure = (_ground_light(REFERENCE_ELEVATION_RAD) / (sun.mean() * towards[2] + sky.mean())) ** 0.8
    cloud = CLOUD * height * (1 - 0.25 * cloudiness) * dusk
    return Daylight(
        sun_direction=towards.astype(np.float32),
        sun_light=(sun * exposure).astype(np.float32),
        sky_light=(sky * exposure).astype(np.float32),
        haze=(haze * dusk * exposure).astype(np.float32),
        zenith=(zenith * exposure).astype(np.float32),
        cloud=(cloud * exposure).astype(np.float32),
        cloudiness=cloudiness,
    )


def _ground_light(elevation_rad: float) -> float:
    sun = SUN_ABOVE_AIR * np.exp(-OPTICAL_DEPTH * _air_mass(elevation_rad))
    return float(sun.mean() * math.sin(elevation_rad) + SKY_LIGHT.mean())


def _air_mass(elevation_rad: float) -> float:
    degrees = math.degrees(elevation_rad)
    return 1 / (math.sin(elevation_rad) + 0.50572 * math.pow(degrees + 6.07995, -1.6364))


AFTERNOON = daylight(REFERENCE_ELEVATION_RAD, math.radians(-112.6))
"""The sun behind a car that drives along x, on its right: holes show a shaded wall and a lit one."""


@cache
def _clouds() -> Texture:
    return Texture(fractal_noise(7, 512, slope=1.3), step_m=0.05)
