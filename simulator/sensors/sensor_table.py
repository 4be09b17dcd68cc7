"""The comparison of simulated with real sensors as a table and as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simulator.sensors.lidar_presets import LIDAR_PRESETS
from simulator.sensors.sensor_comparison import (
    DISTANCES_M,
    ComparisonError,
    Figures,
    Scan,
    figures,
    read_kitti,
    read_nuscenes,
    simulated,
)
from simulator.world import World


@dataclass(frozen=True, slots=True)
class RealFrames:
    """Where a data set's scans are below the data folder, which preset is like its sensor, how many are compared."""

    preset: str
    name: str
    pattern: str
    read: Callable[[Path], Scan]
    frames: int


REAL_FRAMES = (
    RealFrames("hdl64", "KITTI, HDL-64E", "kitti_sequence/velodyne/*.bin", read_kitti, 8),
    RealFrames("hdl32", "nuScenes, HDL-32E", "nuscenes/*.pcd.bin", read_nuscenes, 1),
)


@dataclass(frozen=True, slots=True)
class Comparison:
    """One sensor: figures of the real scans and of as many simulated turns, at least four."""

    preset: str
    name: str
    frames: int
    real: Figures
    simulated: Figures


def compare(data: Path, world: World, seed: int) -> Iterator[Comparison]:
    """A comparison for each data set of `REAL_FRAMES`; `ComparisonError` if one is absent or damaged."""
    for source in REAL_FRAMES:
        paths = sorted(data.glob(source.pattern))
        if not paths:
            raise ComparisonError(f"{data}: has no {source.pattern}; give a folder with these scans by --data")
        chosen = paths[:: max(1, len(paths) // source.frames)][: source.frames]
        real = figures([source.read(path) for path in chosen])
        turns = simulated(world, LIDAR_PRESETS[source.preset](), max(4, source.frames), seed)
        yield Comparison(source.preset, source.name, len(chosen), real, figures(turns))


def markdown(comparison: Comparison) -> str:
    """A table of the form figure | real | simulated."""
    real, ours = comparison.real, comparison.simulated
    difference_deg = ours.elevations_deg - real.elevations_deg
    rows = [
        ("points a turn", f"{real.points:,.0f}", f"{ours.points:,.0f}"),
        ("columns a turn (mean step)", _columns(real), _columns(ours)),
        ("rays without a return", f"{100 * real.missing_share:.1f} %", f"{100 * ours.missing_share:.1f} %"),
        ("elevation of the lowest and highest ring", _ends(real), _ends(ours)),
        ("elevations, root mean square difference", "", f"{math.sqrt(np.nanmean(difference_deg**2)):.3f}\u00b0"),
        ("sensor above the road", f"{real.sensor_height_m:.2f} m", f"{ours.sensor_height_m:.2f} m"),
        *_densities(real, ours),
        (
            "range noise within a ring, on the road",
            f"{1e3 * real.road_noise_m:.1f} mm",
            f"{1e3 * ours.road_noise_m:.1f} mm",
        ),
        ("intensity of the road (10, 50, 90 %)", _list(real.road_intensity, 2), _list(ours.road_intensity, 2)),
        ("range in m (10, 25, 50, 75, 90, 99 %)", _list(real.ranges_m, 1), _list(ours.ranges_m, 1)),
        ("incidence in degrees (10, 25, 50, 75, 90 %)", _list(real.incidence_deg, 0), _list(ours.incidence_deg, 0)),
        *_rings(real, ours),
    ]
    title = f"| {comparison.name} | real ({comparison.frames} frames) | `{comparison.preset}` |"
    return "\n".join([title, "|---|---|---|", *(f"| {' | '.join(row)} |" for row in rows)])


def as_json(comparisons: list[Comparison]) -> str:
    """All figures; NaN becomes null."""
    records = [
        {
            "preset": one.preset,
            "real_frames": one.name,
            "frames": one.frames,
            "bands_m": DISTANCES_M,
            "real": _plain(one.real),
            "simulated": _plain(one.simulated),
        }
        for one in comparisons
    ]
    return json.dumps(records, indent=1) + "\n"


def _columns(one: Figures) -> str:
    return f"{one.columns:.0f} ({360 / one.columns:.4f}\u00b0)"


def _ends(one: Figures) -> str:
    return f"{one.elevations_deg[0]:.2f}\u00b0, {one.elevations_deg[-1]:.2f}\u00b0"


def _densities(real: Figures, ours: Figures) -> Iterator[tuple[str, str, str]]:
    bands = zip(DISTANCES_M, DISTANCES_M[1:], real.road_density, ours.road_density, strict=False)
    for near, far, real_density, our_density in bands:
        yield f"road points a m^2, {near:g} to {far:g} m away", f"{real_density:.1f}", f"{our_density:.1f}"


def _rings(real: Figures, ours: Figures) -> Iterator[tuple[str, str, str]]:
    count = len(real.points_per_ring)
    for first in range(0, count, count // 4):
        part = slice(first, first + count // 4)
        label = f"points a ring, rings {first} to {first + count // 4 - 1} from below"
        yield label, f"{real.points_per_ring[part].mean():.0f}", f"{ours.points_per_ring[part].mean():.0f}"


def _list(values: np.ndarray, digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)


def _plain(one: Figures) -> dict[str, object]:
    return {name: _rounded(getattr(one, name)) for name in Figures.__slots__}


def _rounded(value: float | np.ndarray) -> object:
    if isinstance(value, np.ndarray):
        return [_rounded(float(element)) for element in value]
    return round(float(value), 6) if math.isfinite(value) else None
