"""One obstacle from wishes and a seed: what `headsup simulate pothole` writes and a picture sheet shows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

import numpy as np

from simulator.samples.scan import load_scan, load_scan_true
from simulator.shapes.debris import Debris, DebrisKind, debris, random_sizes
from simulator.shapes.hump import HumpProfile, bump, speed_hump
from simulator.shapes.pothole import PotholeShape
from simulator.shapes.relief import Relief

USUAL_SCAN_LENGTH_M = 0.9


class SampleKind(StrEnum):
    """Families of obstacles."""

    POTHOLE = "pothole"
    BUMP = "bump"
    HUMP = "hump"
    DEBRIS = "debris"


@dataclass(frozen=True, slots=True)
class Wishes:
    """What is asked of a sample; None is left to the seed. `relief_m` is a depth or a height.

    `wall_m`, `lobes`, `water`, `repaired`, `scan` (a mould's PLY file, at its own size if `true_size`) and `fill` are
    for potholes, `grow_percent` for potholes and bumps, `profile` for humps, `shape` for debris.
    """

    length_m: float | None = None
    width_m: float | None = None
    relief_m: float | None = None
    wall_m: float | None = None
    lobes: int | None = None
    water: float | None = None
    repaired: bool = False
    scan: Path | None = None
    true_size: bool = False
    grow_percent: float | None = None
    fill: float | None = None
    profile: HumpProfile | None = None
    shape: DebrisKind | None = None


@dataclass(frozen=True, slots=True)
class Sample:
    """An obstacle and how it came about; `title` is what a picture of it says.

    `hazard` is False for a repair and for a hole filled up.
    """

    name: str
    title: str
    kind: SampleKind
    seed: int
    shape: Relief | Debris
    parameters: dict[str, object]
    hazard: bool = True


def make_sample(kind: SampleKind, seed: int, wishes: Wishes) -> Sample:
    """The obstacle of that kind and seed; `ValueError` for sizes that it cannot have, `ScanError` for a bad scan."""
    name, title = sample_name(kind, seed), "repaired" if wishes.repaired else str(kind)
    match kind:
        case SampleKind.POTHOLE if wishes.scan is not None:
            shape, parameters = _scanned(wishes.scan, wishes)
        case SampleKind.POTHOLE:
            shape, parameters = _pothole(seed, wishes)
        case SampleKind.BUMP:
            shape, parameters = _bump(seed, wishes)
        case SampleKind.HUMP:
            shape, parameters = _hump(seed, wishes)
        case SampleKind.DEBRIS:
            thing, parameters = _debris(seed, wishes)
            return Sample(name, str(parameters["shape"]), kind, seed, thing, parameters)
    worn, wear = _worn(shape, seed, wishes)
    return Sample(name, title, kind, seed, worn, parameters | wear, hazard=not wishes.repaired and wishes.fill != 1)


def sample_name(kind: SampleKind, seed: int) -> str:
    """What `make_sample` calls it."""
    return f"{kind}-{seed:04d}"


def _pothole(seed: int, wishes: Wishes) -> tuple[Relief, dict[str, object]]:
    asked = {
        "length_m": wishes.length_m,
        "width_m": wishes.width_m,
        "depth_m": wishes.relief_m,
        "wall_m": wishes.wall_m,
        "lobes": wishes.lobes,
        "water": wishes.water,
    }
    given = {name: value for name, value in asked.items() if value is not None}
    chosen = replace(PotholeShape.random(seed), **given, repaired=wishes.repaired)  # type: ignore[arg-type]
    return chosen.relief(seed), chosen.parameters()


def _scanned(scan: Path, wishes: Wishes) -> tuple[Relief, dict[str, object]]:
    parameters: dict[str, object] = {"scan": scan.name, "true_size": wishes.true_size}
    if wishes.true_size:
        relief = load_scan_true(scan)
    else:
        relief = load_scan(scan, wishes.length_m or USUAL_SCAN_LENGTH_M, wishes.relief_m)
    return relief.flooded(wishes.water or 0.0), parameters | {"water": wishes.water or 0.0}


def _bump(seed: int, wishes: Wishes) -> tuple[Relief, dict[str, object]]:
    rng = np.random.default_rng([seed, 5])
    # From a root's lump to what stops a car; longer along the root than across it.
    usual = [round(float(rng.uniform(*sides)), 3) for sides in ((0.5, 1.6), (0.4, 1.0), (0.04, 0.10))]
    length_m, width_m, height_m = _sizes(wishes, (usual[0], usual[1], usual[2]))
    relief = bump(seed, length_m, width_m, height_m)
    return relief, {"length_m": length_m, "width_m": width_m, "height_m": height_m}


def _hump(seed: int, wishes: Wishes) -> tuple[Relief, dict[str, object]]:
    profile = wishes.profile or list(HumpProfile)[np.random.default_rng([seed, 6]).integers(len(HumpProfile))]
    length_m, width_m, height_m = _sizes(wishes, (3.7, 3.4, 0.075))
    parameters = {"profile": str(profile), "length_m": length_m, "width_m": width_m, "height_m": height_m}
    return speed_hump(profile, length_m, width_m, height_m), parameters


def _debris(seed: int, wishes: Wishes) -> tuple[Debris, dict[str, object]]:
    kind = wishes.shape or list(DebrisKind)[np.random.default_rng([seed, 3]).integers(len(DebrisKind))]
    length_m, width_m, height_m = _sizes(wishes, random_sizes(kind, seed))
    parameters = {"shape": str(kind), "length_m": length_m, "width_m": width_m, "height_m": height_m}
    return debris(kind, seed, length_m, width_m, height_m), parameters


def _sizes(wishes: Wishes, usual: tuple[float, float, float]) -> tuple[float, float, float]:
    wished = (wishes.length_m, wishes.width_m, wishes.relief_m)
    length, width, height = (u if w is None else w for w, u in zip(wished, usual, strict=True))
    return length, width, height


def _worn(relief: Relief, seed: int, wishes: Wishes) -> tuple[Relief, dict[str, object]]:
    """After it has grown and then been filled, as far as that is wished."""
    wear: dict[str, object] = {}
    if wishes.grow_percent is not None:
        relief, wear["grown_percent"] = relief.aged(wishes.grow_percent), wishes.grow_percent
    if wishes.fill is not None:
        relief, wear["filled"] = relief.filled(wishes.fill, seed), wishes.fill
    return relief, wear
