from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evaluation.composed_scan import CROWNED, FLAT, ScanError, compose, degrade, read_mould, voxel_means
from tests.unit.evaluation.dome_files import write_dome


@pytest.fixture(scope="module")
def mould(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    path = tmp_path_factory.mktemp("scan") / "dome.ply"
    write_dome(path)
    return read_mould(path)


def test_the_hole_begins_one_millimetre_below_a_flat_road(mould: np.ndarray) -> None:
    scene = compose(mould, FLAT, np.random.default_rng(1))
    assert scene.points_mm[scene.truth, 2].max() == pytest.approx(-1.0)
    assert (scene.points_mm[~scene.truth, 2] == 0.0).all()


def test_the_hole_is_the_mould_turned_over_and_divided_by_1_2_to_2(mould: np.ndarray) -> None:
    scene = compose(mould, FLAT, np.random.default_rng(1))
    hole = scene.points_mm[scene.truth]
    shrink = 80.0 / np.ptp(hole[:, 0])
    assert 1.2 < shrink < 2.05
    assert np.ptp(hole[:, 2]) == pytest.approx(30.0 / shrink, rel=0.1)
    middle = hole[:, :2].mean(axis=0)
    near, far = (np.hypot(*(hole[:, :2] - middle).T) < 5, np.hypot(*(hole[:, :2] - middle).T) > 18)
    assert hole[near, 2].mean() < hole[far, 2].mean()


def test_no_road_lies_over_the_hole_and_little_is_missing_around_it(mould: np.ndarray) -> None:
    scene = compose(mould, FLAT, np.random.default_rng(2))
    hole, ground = scene.points_mm[scene.truth], scene.points_mm[~scene.truth]
    middle = 0.5 * (hole[:, :2].min(axis=0) + hole[:, :2].max(axis=0))
    radius = 0.5 * np.ptp(hole[:, 0])
    away = np.hypot(*(ground[:, :2] - middle).T)
    assert away.min() > radius - 3.0
    assert away.min() < radius + 3.0
    assert len(ground) == pytest.approx((600**2 - np.pi * radius**2) / 4.0, rel=0.01)


def test_the_second_road_falls_by_two_percent_and_is_rough_by_a_millimetre(mould: np.ndarray) -> None:
    scene = compose(mould, CROWNED, np.random.default_rng(3))
    ground = scene.points_mm[~scene.truth]
    edge, middle = np.abs(ground[:, 1]) > 290, np.abs(ground[:, 1]) < 10
    assert ground[middle, 2].mean() - ground[edge, 2].mean() == pytest.approx(0.02 * 300, abs=0.7)
    assert ground[middle, 2].std() == pytest.approx(1.0, abs=0.2)


def test_thinning_keeps_the_share_and_noise_moves_every_point(mould: np.ndarray) -> None:
    whole = compose(mould, FLAT, np.random.default_rng(1))
    thin = degrade(whole, 10, 0.5, np.random.default_rng(5))
    assert len(thin.truth) == pytest.approx(0.1 * len(whole.truth), rel=0.05)
    assert thin.truth.mean() == pytest.approx(whole.truth.mean(), rel=0.2)
    ground = thin.points_mm[~thin.truth]
    assert ground[:, 2].std() == pytest.approx(0.5, rel=0.05)


def test_without_thinning_and_noise_the_scene_is_as_composed(mould: np.ndarray) -> None:
    whole = compose(mould, FLAT, np.random.default_rng(1))
    assert (degrade(whole, 100, 0.0, np.random.default_rng(5)).points_mm == whole.points_mm).all()


def test_the_same_seed_gives_the_same_scene_and_another_seed_another(mould: np.ndarray) -> None:
    one, same, other = (compose(mould, CROWNED, np.random.default_rng(seed)).points_mm for seed in (1, 1, 2))
    assert one.tobytes() == same.tobytes()
    assert one.tobytes() != other.tobytes()


def test_a_voxel_keeps_the_mean_of_its_points() -> None:
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.5], [5.0, 5.0, 5.0]])
    assert voxel_means(points, 2.0).tolist() == [[0.5, 0.0, 0.25], [5.0, 5.0, 5.0]]


def test_a_file_without_points_is_refused(tmp_path: Path) -> None:
    (tmp_path / "broken.ply").write_text("no cloud")
    with pytest.raises(ScanError, match="0 points were read"):
        read_mould(tmp_path / "broken.ply")
