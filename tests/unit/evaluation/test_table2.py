from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from typer.testing import CliRunner

from detector.types import FrameDetection, PointClass
from evaluation.stereo import StereoError, StereoFrame, cloud_of, frames_in, mask_of, matched_pixels, read_frame
from evaluation.table2 import PAPER_POTHOLE_SHARE, Pixels, Potholes, paper_crop, pixels_of, potholes_of, score_frames
from headsup.evaluate.app import evaluate_app
from tests.unit.evaluation.dome_files import stereo_frame, write_stereo

MASKS = hnp.arrays(bool, (12, 14))


def detection(obstacle: np.ndarray) -> FrameDetection:
    labels = np.where(obstacle, PointClass.OBSTACLE, PointClass.SAFE_ROAD).astype(np.uint8)
    return FrameDetection(labels, np.zeros(len(labels), np.float32), np.full(len(labels), -0.1, np.float32), ())


def block(rows: slice, columns: slice, shape: tuple[int, int] = (60, 80)) -> np.ndarray:
    mask = np.zeros(shape, dtype=bool)
    mask[rows, columns] = True
    return mask


@given(truth=MASKS, mask=MASKS)
def test_every_pixel_counts_once_and_rates_stay_between_0_and_1(truth: np.ndarray, mask: np.ndarray) -> None:
    pixels = pixels_of(truth, mask)
    parts = (pixels.true_positive, pixels.false_negative, pixels.false_positive, pixels.true_negative)
    assert (sum(parts), min(parts) >= 0) == (truth.size, True)
    for rate in (pixels.recall, pixels.precision, pixels.accuracy, pixels.f_score):
        assert 0.0 <= rate <= 1.0


def test_f_is_the_harmonic_mean_of_recall_and_precision() -> None:
    pixels = Pixels(80, 20, 40, 860)
    assert pixels.f_score == pytest.approx(2 * 0.8 * (80 / 120) / (0.8 + 80 / 120))
    assert pixels.accuracy == pytest.approx(0.94)


def test_a_pothole_is_correct_when_half_of_its_label_is_covered() -> None:
    truth = block(slice(10, 30), slice(10, 30))
    assert potholes_of(truth, block(slice(10, 20), slice(10, 30))) == Potholes(1, 0, 0)
    assert potholes_of(truth, block(slice(10, 19), slice(10, 30))) == Potholes(0, 0, 1)


def test_labels_of_fewer_than_120_pixels_do_not_count_and_near_ones_are_one() -> None:
    assert potholes_of(block(slice(0, 10), slice(0, 11)), np.zeros((60, 80), bool)) == Potholes(0, 0, 0)
    parted = block(slice(10, 30), slice(10, 20)) | block(slice(10, 30), slice(24, 34))
    assert potholes_of(parted, parted) == Potholes(1, 0, 0)


def test_a_component_of_which_less_than_a_tenth_is_labelled_is_incorrect() -> None:
    truth = block(slice(0, 20), slice(0, 20))
    assert potholes_of(truth, truth | block(slice(40, 50), slice(40, 50))) == Potholes(1, 1, 0)


def test_the_papers_figures_imply_seven_and_a_half_percent_of_potholes() -> None:
    assert pytest.approx(0.0752, abs=0.0005) == PAPER_POTHOLE_SHARE


@given(top=st.integers(0, 40), left=st.integers(0, 60), height=st.integers(1, 20), width=st.integers(1, 20))
def test_the_crop_holds_the_labels_and_at_most_the_papers_share_or_everything(
    top: int, left: int, height: int, width: int
) -> None:
    truth = block(slice(top, top + height), slice(left, left + width))
    rows, columns = paper_crop(truth)
    crop = truth[rows, columns]
    assert crop.sum() == truth.sum()
    assert crop.mean() <= PAPER_POTHOLE_SHARE or crop.shape == truth.shape


def test_a_frame_without_labels_is_its_own_crop() -> None:
    rows, columns = paper_crop(np.zeros((30, 40), bool))
    assert (rows, columns) == (slice(0, 30), slice(0, 40))


def test_no_match_and_matches_far_below_the_road_have_no_point() -> None:
    disparity = np.full((10, 10), 40_000, dtype=np.uint16)
    disparity[0, 0], disparity[1, 1], disparity[2, 2] = 0, 9_000, 12_000
    matched = matched_pixels(disparity)
    assert (matched[0, 0], matched[1, 1], matched[2, 2], matched.sum()) == (False, False, True, 98)
    cloud = cloud_of(disparity, matched)
    assert cloud.shape == (98, 3)
    assert cloud[:, 2].argmin() == np.flatnonzero(matched.ravel()).tolist().index(22)


def test_pixels_without_match_belong_to_the_hole_that_hides_them_and_only_then() -> None:
    matched = np.ones((40, 40), dtype=bool)
    hole = block(slice(10, 20), slice(10, 30), (40, 40))
    beside_hole, far = block(slice(20, 25), slice(12, 28), (40, 40)), block(slice(33, 36), slice(5, 9), (40, 40))
    matched[beside_hole | far] = False
    mask = mask_of(detection(hole[matched]), matched)
    # The corners are rounded by the majority of their neighbours.
    assert (mask ^ (hole | beside_hole)).sum() <= 8
    assert not (mask & far).any()


def test_a_thing_that_stands_on_the_road_is_not_in_the_mask() -> None:
    matched = np.ones((20, 20), dtype=bool)
    standing = detection(block(slice(5, 10), slice(5, 10), (20, 20)).ravel())
    standing.residual_m[:] = 0.1
    assert not mask_of(standing, matched).any()


def test_a_made_up_frame_is_scored_nearly_perfectly(tmp_path: Path) -> None:
    write_stereo(tmp_path)
    (scored,) = score_frames(frames_in(tmp_path))
    assert scored.full.f_score > 0.93
    assert scored.potholes == Potholes(1, 0, 0)


def test_the_command_writes_masks_of_the_inputs_size_pictures_and_sums(tmp_path: Path) -> None:
    write_stereo(tmp_path / "data/stereo")
    write_stereo(tmp_path / "data/stereo", "dataset2", "37", seed=1)
    arguments = ["table2", "--data", tmp_path / "data", "--save-masks", tmp_path / "masks"]
    arguments += ["--pictures", tmp_path / "pictures", "--json", tmp_path / "t.json"]
    result = CliRunner().invoke(evaluate_app, [str(argument) for argument in arguments])
    assert result.exit_code == 0
    assert "0.945" in result.stdout
    mask = cv2.imread(str(tmp_path / "masks/dataset1/01_mask.png"), cv2.IMREAD_UNCHANGED)
    assert (mask.shape, mask.dtype, set(np.unique(mask))) == ((240, 320), np.uint8, {0, 255})
    assert cv2.imread(str(tmp_path / "pictures/dataset2/37.png")).shape == (240, 320, 3)
    sums = {record["name"]: record for record in json.loads((tmp_path / "t.json").read_text())}
    assert sums["total"]["frames"] == 2
    assert sums["total without frames left out"]["frames"] == 1
    assert sums["total"]["full"]["f_score"] > 0.93


def test_a_missing_label_a_wrong_picture_and_an_empty_folder_are_named(tmp_path: Path) -> None:
    with pytest.raises(StereoError, match=r"disparity\.png"):
        frames_in(tmp_path)
    write_stereo(tmp_path)
    files = (tmp_path / "dataset1/01_disparity.png", tmp_path / "dataset1/01_label.png")
    cv2.imwrite(str(files[0]), np.zeros((4, 4), np.uint8))
    with pytest.raises(StereoError, match="16-bit"):
        read_frame(*files)
    files[1].unlink()
    with pytest.raises(StereoError, match=r"01_label\.png is missing"):
        frames_in(tmp_path)
    result = CliRunner().invoke(evaluate_app, ["table2", "--data", str(tmp_path / "nothing")])
    assert result.exit_code == 1
    assert len(result.stderr.strip().splitlines()) == 1


def test_the_frames_that_the_authors_leave_out_are_known() -> None:
    disparity, label = stereo_frame()
    assert StereoFrame("dataset2", "37", disparity, label).left_out
    assert not StereoFrame("dataset1", "13", disparity, label).left_out
