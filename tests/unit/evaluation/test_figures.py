"""The figures are drawn from what the detector says, the same each time."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from typer.testing import CliRunner

from detector.types import PointClass
from evaluation.figure_style import CLASS_COLOURS, CLASS_MEANINGS, class_colours
from evaluation.figures_lidar import draw_lidar, simulated_frame
from evaluation.figures_scan import draw_scan
from evaluation.figures_stereo import HIT, draw_stereo, first_frames
from evaluation.figures_surface import draw_surface, simulated_survey
from headsup.evaluate.app import evaluate_app


def dome() -> np.ndarray:
    """A mould of a round hole of 120 mm, 25 mm deep, as scans are: convex, in millimetres."""
    axis = np.arange(-60.0, 60.0, 1.5)
    x, y = (a.ravel() for a in np.meshgrid(axis, axis))
    inside = np.hypot(x, y) < 60.0
    z = 25.0 * np.sqrt(1.0 - np.square(np.hypot(x, y)[inside] / 60.0))
    return np.column_stack([x[inside], y[inside], z])


def pixels_of(path: Path, colour: tuple[float, float, float]) -> int:
    picture = cv2.imread(str(path)).astype(np.float64)[..., ::-1] / 255.0
    return int((np.abs(picture - np.array(colour)).max(axis=2) < 0.02).sum())


def stereo_data(folder: Path) -> Path:
    """Two data sets of one frame each: noise about a level, and a labelled hole in it."""
    rng = np.random.default_rng(1)
    for dataset in ("dataset1", "dataset2"):
        (folder / "stereo" / dataset).mkdir(parents=True)
        rows, columns = np.mgrid[:240, :320]
        hole = np.hypot(rows - 120, columns - 160) < 40
        disparity = 30_000 + rng.normal(0, 300, hole.shape) - 20_000 * hole
        label = hole.astype(np.uint8) * 255
        cv2.imwrite(str(folder / "stereo" / dataset / "01_disparity.png"), disparity.astype(np.uint16))
        cv2.imwrite(str(folder / "stereo" / dataset / "01_label.png"), label)
    return folder


def test_every_class_has_a_colour_of_its_own_and_a_meaning() -> None:
    assert set(CLASS_COLOURS) == set(CLASS_MEANINGS) == set(PointClass)
    assert len(set(CLASS_COLOURS.values())) == len(PointClass)
    assert class_colours(np.array([1, 5], dtype=np.uint8)) == [
        CLASS_COLOURS[PointClass.SAFE_ROAD],
        CLASS_COLOURS[PointClass.OBSTACLE],
    ]


def test_a_scans_figure_shows_the_pothole_in_truth_and_estimates_with_the_same_bytes_each_time(tmp_path: Path) -> None:
    for name in ("once.png", "again.png"):
        draw_scan(tmp_path / name, dome(), "a dome", 0.0, seed=1, densities_percent=(5,))
    assert pixels_of(tmp_path / "once.png", (0xF0 / 255, 0x24 / 255, 0x1A / 255)) > 5000
    assert (tmp_path / "once.png").read_bytes() == (tmp_path / "again.png").read_bytes()


def test_a_found_hole_is_green_in_the_stereo_figure(tmp_path: Path) -> None:
    frames = first_frames(stereo_data(tmp_path))
    assert [frame.frame.dataset for frame in frames] == ["dataset1", "dataset2"]
    draw_stereo(tmp_path / "stereo.png", frames)
    assert pixels_of(tmp_path / "stereo.png", HIT) > 1000


def test_a_surveyed_pothole_is_drawn_with_its_points(tmp_path: Path) -> None:
    draw_surface(tmp_path / "surface.png", simulated_survey(1))
    picture = cv2.imread(str(tmp_path / "surface.png"))
    # Points of what is found are red on grey.
    assert int((picture[..., 2].astype(int) - picture[..., 1] > 60).sum()) > 500


def test_a_simulated_sweep_shows_blue_road_and_red_obstacle(tmp_path: Path) -> None:
    draw_lidar(tmp_path / "lidar.png", simulated_frame("paper"))
    assert pixels_of(tmp_path / "lidar.png", (0x2F / 255, 0x6B / 255, 1.0)) > 2000
    assert pixels_of(tmp_path / "lidar.png", (0xF0 / 255, 0x24 / 255, 0x1A / 255)) > 20


def test_a_folder_that_is_not_there_is_refused_in_one_line(tmp_path: Path) -> None:
    result = CliRunner().invoke(
        evaluate_app, ["figures", "--data", str(tmp_path / "nowhere"), "--out", str(tmp_path / "out")]
    )
    assert result.exit_code == 1
    assert "no such folder" in result.output
