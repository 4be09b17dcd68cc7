"""The detector on real scans, frames and depth images, with the figures that the guide states."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from detector.types import ObstacleKind
from evaluation.composed_scan import FLAT, compose, degrade, read_mould
from evaluation.depth_camera import SAND_M3, measure_scan
from evaluation.stereo import frames_in
from evaluation.survey_detection import below_road, detect_survey
from evaluation.table1 import rates_of
from evaluation.table2 import score_frames, summarise

DATA = Path(os.environ.get("HEADSUP_DATA", Path(__file__).parents[4] / "shared" / "data"))

pytestmark = pytest.mark.realdata


def data(pattern: str) -> list[Path]:
    found = sorted(DATA.glob(pattern))
    if not found:
        pytest.skip(f"no {pattern} under {DATA}: set HEADSUP_DATA")
    return found


@pytest.mark.parametrize("name", ["p1", "p2"])
def test_a_pothole_before_a_depth_camera_holds_what_the_sand_measured(name: str) -> None:
    (path,) = data(f"pothole_rgbd/{name}.ply")
    found = measure_scan(path).obstacles
    assert [o.kind for o in found] == [ObstacleKind.POTHOLE]
    assert found[0].volume_m3 == pytest.approx(SAND_M3[name], rel=0.03)


@pytest.mark.parametrize(
    ("density", "noise_mm", "least_found", "least_left"),
    [(100, 0.0, 99.98, 99.9), (5, 0.0, 99.98, 99.9), (100, 0.5, 99.9, 99.9), (100, 1.0, 99.0, 99.8)],
)
def test_points_of_scanned_potholes_are_told_from_their_road(
    density: int, noise_mm: float, least_found: float, least_left: float
) -> None:
    rates = []
    for path in data("potholes/*.ply")[:2]:
        rng = np.random.default_rng(11)
        scene = degrade(compose(read_mould(path), FLAT, rng), density, noise_mm, rng)
        rates.append(rates_of(scene.truth, below_road(detect_survey(1e-3 * scene.points_mm))))
    assert np.mean([rate.RP for rate in rates]) >= least_found
    assert np.mean([rate.RR for rate in rates]) >= least_left


def test_every_twelfth_stereo_frame_has_its_potholes_and_no_other() -> None:
    data("stereo/dataset2/*_disparity.png")
    total = summarise("some", score_frames(frames_in(DATA)[::12]))
    assert (total.potholes.incorrect, total.potholes.missed) == (0, 0)
    assert total.full.f_score > 0.89
