"""The paper's Table I anew: which points of a scanned pothole in a road are called pothole, by density and noise."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean

import numpy as np
from numpy.typing import NDArray

from evaluation.composed_scan import (
    CROWNED,
    DENSITIES_PERCENT,
    FLAT,
    NOISES_MM,
    FloatArray,
    Road,
    ScanError,
    Scene,
    compose,
    degrade,
    read_mould,
)
from evaluation.peers import PATCH_PEERS
from evaluation.survey_detection import below_road, detect_survey

Classifier = Callable[[FloatArray], NDArray[np.bool_]]
"""Points (N, 3) in metres -> mask (N,) of those called pothole."""

METHODS: dict[str, Classifier] = {
    "surface": lambda points_m: below_road(detect_survey(points_m, "surface")),
    "saliency": lambda points_m: below_road(detect_survey(points_m, "saliency")),
    **PATCH_PEERS,
}
ROADS = (FLAT, CROWNED)
METRES_PER_MM = 1e-3

# Table I, last row: the average of the paper's 13 scans, without noise, in %.
PAPER = {100: (99.98, 99.51), 50: (99.85, 99.57), 10: (99.83, 99.25), 5: (99.88, 99.01)}


@dataclass(frozen=True, slots=True)
class Rates:
    """Shares in %: of pothole points called pothole (RP) or road (NR), of road points called pothole (NP) or road
    (RR)."""

    RP: float
    NR: float
    NP: float
    RR: float


@dataclass(frozen=True, slots=True)
class Row:
    """The rates of one method on one scene; `scan` is "average" for the mean over the scans."""

    road: str
    scan: str
    method: str
    density_percent: int
    noise_mm: float
    rates: Rates

    def record(self) -> dict[str, object]:
        """As JSON, the rates beside the rest."""
        row = asdict(self)
        return {**{key: value for key, value in row.items() if key != "rates"}, **row["rates"]}


@dataclass(frozen=True, slots=True)
class Scored:
    """One scene with what every method calls pothole."""

    road: Road
    scan: str
    density_percent: int
    noise_mm: float
    scene: Scene
    called: dict[str, NDArray[np.bool_]]

    @property
    def stem(self) -> str:
        """Name of the scene's file."""
        return f"{self.scan}_d{self.density_percent}_n{self.noise_mm:.2f}"

    def rows(self) -> list[Row]:
        """The rates of every method."""
        at = (self.density_percent, self.noise_mm)
        return [
            Row(self.road.name, self.scan, method, *at, rates_of(self.scene.truth, called))
            for method, called in self.called.items()
        ]


def scans_in(folder: Path) -> list[Path]:
    """The PLY files of a folder, or of its `potholes`. Raises ScanError where there are none."""
    found = sorted(folder.glob("*.ply")) or sorted((folder / "potholes").glob("*.ply"))
    if not found:
        raise ScanError(f"{folder}: no *.ply there nor in {folder / 'potholes'}; give --data the folder of the scans")
    return found


def scene_count(scans: int) -> int:
    """Number of scenes of so many scans."""
    return scans * len(ROADS) * len(DENSITIES_PERCENT) * len(NOISES_MM)


def score_scans(paths: list[Path], seed: int, methods: tuple[str, ...]) -> Iterator[Scored]:
    """Every scan in both roads at every density and noise. The same seed gives the same scenes, whatever else runs."""
    for path in paths:
        mould = read_mould(path)
        for number, road in enumerate(ROADS):
            whole = compose(mould, road, np.random.default_rng([seed, number, 0]))
            for density in DENSITIES_PERCENT:
                for noise in NOISES_MM:
                    rng = np.random.default_rng([seed, number, density, round(100 * noise)])
                    scene = degrade(whole, density, noise, rng)
                    called = {name: METHODS[name](scene.points_mm * METRES_PER_MM) for name in methods}
                    yield Scored(road, path.stem, density, noise, scene, called)


def rates_of(truth: NDArray[np.bool_], called: NDArray[np.bool_]) -> Rates:
    """Rates of a mask against the truth (N,); 0 where a class is empty."""
    pothole = 100.0 * float(called[truth].mean()) if truth.any() else 0.0
    road = 100.0 * float((~called[~truth]).mean()) if not truth.all() else 0.0
    return Rates(pothole, 100.0 - pothole, 100.0 - road, road)


def averages(rows: list[Row]) -> list[Row]:
    """Mean over the scans for each road, method, density and noise, in the order they came."""
    groups: dict[tuple[str, str, int, float], list[Rates]] = {}
    for row in rows:
        groups.setdefault((row.road, row.method, row.density_percent, row.noise_mm), []).append(row.rates)
    return [
        Row(road, "average", method, density, noise, _mean(rates))
        for (road, method, density, noise), rates in groups.items()
    ]


def _mean(rates: list[Rates]) -> Rates:
    return Rates(*(fmean(getattr(rate, name) for rate in rates) for name in ("RP", "NR", "NP", "RR")))
