"""Rings that read too long or too short: found by their elevation, and put back on the road."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from detector.passes.accumulator import PlaceHits
from detector.passes.local_surface import levelled
from detector.road.ring_bias import number_rings, ring_offsets

HEIGHT_M = 1.8


@dataclass(frozen=True)
class Pass:
    """Hits of a pass over level road, and the true place of each."""

    hits: PlaceHits
    true_xy_m: np.ndarray
    ring: np.ndarray


def level_pass(bias_sd_m: float, noise_m: float = 0.005, frames: int = 12) -> Pass:
    """Rings half a degree apart, each with its own constant error of range."""
    rng = np.random.default_rng(1)
    elevation = np.radians(np.arange(-26.0, -10.0, 0.5))
    bias = rng.normal(0.0, bias_sd_m, elevation.size)
    ring, azimuth = (a.ravel() for a in np.meshgrid(np.arange(elevation.size), np.radians(np.arange(-20, 20, 0.2))))
    points, true, frame, origins, rings = [], [], [], [], []
    for number in range(frames):
        origin = np.array([-8.0 + 0.4 * number, 0.0, HEIGHT_M])
        ray = np.column_stack(
            [
                np.cos(elevation[ring]) * np.cos(azimuth),
                np.cos(elevation[ring]) * np.sin(azimuth),
                np.sin(elevation[ring]),
            ]
        )
        range_m = HEIGHT_M / -ray[:, 2]
        hit = origin + ray * (range_m + bias[ring] + rng.normal(0.0, noise_m, ring.size))[:, None]
        on_road = origin + ray * range_m[:, None]
        near = (np.abs(hit[:, :2]) < 1.5).all(axis=1)
        if near.any():
            points.append(hit[near])
            true.append(on_road[near, :2])
            rings.append(ring[near])
            frame.append(np.full(int(near.sum()), len(origins)))
            origins.append(origin)
    hits = PlaceHits(np.concatenate(points), np.concatenate(frame), np.array(origins), np.zeros(2), 1.5)
    return Pass(hits, np.concatenate(true), np.concatenate(rings))


def test_every_ring_of_a_sweep_is_told_from_the_others() -> None:
    drive = level_pass(0.03)
    hits = drive.hits
    from_sensor = hits.points_m - hits.origins_m[hits.frame]
    starts = np.searchsorted(hits.frame, np.arange(hits.frames + 1))
    found = number_rings(from_sensor, -hits.origins_m[:, :2], starts, np.ones(len(from_sensor), dtype=bool))
    pairs = {(f, r, n) for f, r, n in zip(hits.frame, drive.ring, found, strict=True)}
    assert len(pairs) == len({(f, r) for f, r, _ in pairs}) == len({n for _, _, n in pairs})


def test_levelling_takes_the_rings_bias_out_of_heights_and_places() -> None:
    drive = level_pass(0.03)
    level = levelled(drive.hits)
    assert np.std(drive.hits.points_m[:, 2]) > 0.007
    assert np.std(level.height_m) < 0.003
    before, after = (np.std(xy - drive.true_xy_m) for xy in (drive.hits.points_m[:, :2], level.xy_m))
    assert after < 0.5 * before


def test_a_sensor_without_bias_is_left_alone() -> None:
    drive = level_pass(0.0)
    assert np.abs(levelled(drive.hits).xy_m - drive.hits.points_m[:, :2]).max() < 0.004


def test_the_noise_that_levelling_states_is_that_of_the_hits() -> None:
    noisy = level_pass(0.0, noise_m=0.02)
    assert levelled(noisy.hits).noise_m == pytest.approx(noisy.hits.points_m[:, 2].std(), rel=0.15)


def test_rings_with_too_few_hits_are_not_shifted() -> None:
    ring = np.array([0, 0, 1, 1])
    assert ring_offsets(ring, np.array([0.1, 0.1, -0.1, -0.1]), np.ones(4, dtype=bool)) == pytest.approx(np.zeros(4))
