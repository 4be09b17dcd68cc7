"""Tables of dense clouds hand the detector points in metres and nothing else, and take its defaults."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import evaluation.survey_detection as survey_detection
from detector.types import DetectorInput, FrameDetection
from evaluation import table1
from evaluation.depth_camera import measure_scan, to_road_axes
from evaluation.stereo import frames_in
from evaluation.table1 import score_scans
from evaluation.table2 import score_frames
from tests.unit.detector.surveys import bowl, road
from tests.unit.evaluation.dome_files import write_dome, write_ply, write_stereo

Call = tuple[DetectorInput, tuple[Any, ...], dict[str, Any]]


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[Call]:
    """What reaches the detector, which still runs."""
    recorded: list[Call] = []
    detect = survey_detection.detect

    def recording(sweep: DetectorInput, *rest: Any, **named: Any) -> FrameDetection:
        recorded.append((sweep, rest, named))
        return detect(sweep, *rest, **named)

    monkeypatch.setattr(survey_detection, "detect", recording)
    return recorded


def assert_points_and_method_only(calls: list[Call], methods: set[str]) -> None:
    assert {rest[0] for _, rest, _ in calls} == methods
    for sweep, rest, named in calls:
        assert (len(rest), named) == (1, {})
        assert sweep.points_m.dtype == np.float32
        assert sweep.sensor_height_m is None
        plain = DetectorInput(sweep.points_m, None)
        others = [field.name for field in fields(DetectorInput) if field.name != "points_m"]
        assert all(getattr(sweep, name) == getattr(plain, name) for name in others)


def test_table_1_passes_points_in_metres_and_the_method(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, calls: list[Call]
) -> None:
    monkeypatch.setattr(table1, "DENSITIES_PERCENT", (5,))
    monkeypatch.setattr(table1, "NOISES_MM", (0.5,))
    write_dome(tmp_path / "dome.ply", count=5_000)
    assert len(list(score_scans([tmp_path / "dome.ply"], 1, ("surface", "saliency")))) == 2
    assert_points_and_method_only(calls, {"surface", "saliency"})
    assert all(np.ptp(sweep.points_m[:, 0]) == pytest.approx(0.6, abs=0.02) for sweep, _, _ in calls)


def test_table_2_passes_points_in_metres(tmp_path: Path, calls: list[Call]) -> None:
    write_stereo(tmp_path)
    assert len(list(score_frames(frames_in(tmp_path)))) == 1
    assert_points_and_method_only(calls, {"surface"})
    assert np.ptp(calls[0][0].points_m[:, 0]) == pytest.approx(319 * 1.2 / 700, abs=1e-3)


def test_the_depth_camera_passes_points_in_metres(tmp_path: Path, calls: list[Call]) -> None:
    write_ply(tmp_path / "scan.ply", bowl(road(8_000)) - [0.0, 0.0, 0.6])
    scan = measure_scan(tmp_path / "scan.ply")
    assert_points_and_method_only(calls, {"surface"})
    assert len(scan.obstacles) == 1
    assert scan.sand_m3 is None


def test_a_camera_whose_depth_grows_forward_is_turned_over() -> None:
    points = bowl(road(2_000)) - [0.0, 0.0, 0.6]
    seen = points * [1.0, -1.0, -1.0]
    assert to_road_axes(seen) == pytest.approx(points)
    assert to_road_axes(points) is points
