from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detector.errors import DetectorError
from detector.pipeline import detect
from detector.types import DetectorInput, FrameDetection, ObstacleKind, PointClass
from tests.unit.detector.surveys import bowl, road


def survey(points: np.ndarray, method: str = "surface") -> FrameDetection:
    return detect(DetectorInput(np.ascontiguousarray(points, dtype=np.float32), None), method)  # type: ignore[arg-type]  # a str of two


def test_a_hole_is_found_with_its_size_depth_and_volume() -> None:
    found = survey(bowl(road())).obstacles
    assert [o.kind for o in found] == [ObstacleKind.POTHOLE]
    assert found[0].length_m == pytest.approx(0.4, abs=0.04)
    assert found[0].width_m == pytest.approx(0.3, abs=0.04)
    assert found[0].relief_m == pytest.approx(0.06, rel=0.05)
    # An ellipse whose walls lean in over the outer tenth: the mean of the shares (1 - t)^2, t in 0..0.1.
    assert found[0].volume_m3 == pytest.approx(0.06 * math.pi * 0.4 * 0.3 / 4 * 0.903, rel=0.06)
    assert np.hypot(*found[0].centre_m[:2]) < 0.01


def test_the_hole_is_obstacle_the_road_is_safe_and_residuals_point_down() -> None:
    points = bowl(road())
    detection = survey(points)
    floor = np.hypot(points[:, 0] / 0.2, points[:, 1] / 0.15) < 0.85
    away = np.hypot(points[:, 0] / 0.2, points[:, 1] / 0.15) > 1.3
    assert (detection.labels[floor] == PointClass.OBSTACLE).all()
    assert (detection.labels[away] == PointClass.SAFE_ROAD).mean() > 0.999
    assert detection.residual_m[floor].mean() == pytest.approx(-0.06, abs=0.004)
    assert detection.saliency[floor].min() > 0.9


def test_what_rises_is_no_pothole() -> None:
    found = survey(bowl(road(), depth_m=-0.06)).obstacles
    assert [o.kind.is_negative for o in found] == [False]
    assert found[0].relief_m == pytest.approx(0.06, rel=0.1)


@pytest.mark.parametrize("seed", range(4))
def test_a_sound_road_with_waves_has_none(seed: int) -> None:
    points = road(seed=seed)
    points[:, 2] += 0.004 * np.sin(7.0 * points[:, 0] + seed) + 0.003 * np.cos(5.0 * points[:, 1])
    assert survey(points).obstacles == ()


def test_a_corner_that_falls_away_is_no_hole() -> None:
    points = road()
    points[:, 2] -= 0.1 * np.clip(points[:, 0] + points[:, 1] - 1.0, 0.0, None)
    assert survey(points).obstacles == ()


def test_a_worn_apron_is_flagged_but_lies_outside_the_outline() -> None:
    points = bowl(road(40_000))
    reach = np.hypot(points[:, 0] / 0.2, points[:, 1] / 0.15)
    apron = (reach > 1.1) & (reach < 1.5)
    points[:, 2] -= 0.012 * np.clip((1.6 - reach) / 0.5, 0.0, 1.0)
    detection = survey(points)
    assert detection.obstacles[0].length_m < 0.48
    assert (detection.labels[apron] == PointClass.OBSTACLE).mean() < 0.2
    assert np.isin(detection.labels[apron], (PointClass.NEGATIVE, PointClass.OBSTACLE)).mean() > 0.8


def test_a_part_that_a_wall_hides_belongs_to_the_hole() -> None:
    points = bowl(road(40_000))
    hidden = (np.hypot(points[:, 0] / 0.2, points[:, 1] / 0.15) < 0.97) & (points[:, 1] < -0.03)
    found = survey(points[~hidden]).obstacles
    assert len(found) == 1
    assert found[0].width_m == pytest.approx(0.3, abs=0.05)
    assert found[0].centre_m[1] == pytest.approx(0.0, abs=0.02)


def test_volume_does_not_depend_on_how_densely_the_hole_was_measured() -> None:
    points = bowl(road(60_000))
    right = (points[:, 0] > 0.0) & (np.hypot(points[:, 0], points[:, 1]) < 0.25)
    thinned = points[~right | (np.arange(len(points)) % 3 == 0)]
    assert survey(thinned).obstacles[0].volume_m3 == pytest.approx(survey(points).obstacles[0].volume_m3, rel=0.03)


def test_a_scan_whose_points_are_all_there_three_times_shows_the_same_hole() -> None:
    points = bowl(road())
    once, thrice = survey(points).obstacles, survey(np.repeat(points, 3, axis=0)).obstacles
    assert [(o.kind, round(o.length_m, 6), round(o.volume_m3, 9)) for o in thrice] == [
        (o.kind, round(o.length_m, 6), round(o.volume_m3, 9)) for o in once
    ]


def test_a_tilted_survey_is_levelled() -> None:
    points = bowl(road())
    tilt = math.radians(20.0)
    turned = points @ np.array([[1, 0, 0], [0, math.cos(tilt), -math.sin(tilt)], [0, math.sin(tilt), math.cos(tilt)]]).T
    found = survey(turned + np.array([3.0, -2.0, 5.0])).obstacles
    assert len(found) == 1
    assert found[0].relief_m == pytest.approx(0.06, rel=0.05)
    assert found[0].centre_m == pytest.approx([3.0, -2.0, 5.0], abs=0.02)


@settings(max_examples=8, deadline=None)
@given(angle=st.floats(0.0, 2.0 * math.pi), x=st.floats(-20.0, 20.0), y=st.floats(-20.0, 20.0))
def test_turning_and_shifting_the_cloud_turns_and_shifts_the_answer(angle: float, x: float, y: float) -> None:
    points = bowl(road(8_000), at=(0.2, 0.1))
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    moved = np.column_stack([points[:, :2] @ turn.T + [x, y], points[:, 2]])
    before, after = survey(points), survey(moved)
    assert (before.labels == after.labels).mean() > 0.99
    one, other = before.obstacles[0], after.obstacles[0]
    assert other.centre_m[:2] == pytest.approx(turn @ one.centre_m[:2] + [x, y], abs=0.01)
    assert (other.length_m, other.width_m) == pytest.approx((one.length_m, one.width_m), rel=0.06)
    turned = (other.yaw_rad - one.yaw_rad - angle) % math.pi
    assert min(turned, math.pi - turned) < 0.25


@pytest.mark.parametrize("method", ["surface", "saliency"])
@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3)),
        np.ones((1, 3)),
        np.ones((500, 3)),
        np.column_stack([np.linspace(0, 1, 500)] * 2 + [np.zeros(500)]),
        np.column_stack([np.linspace(0, 1, 500), np.zeros(500), np.linspace(0, 1, 500) ** 2]),
        np.full((100, 3), np.nan),
        np.full((100, 3), np.inf),
        np.stack(np.meshgrid(np.arange(20) * 0.1, np.arange(20) * 0.1, [0.0]), axis=-1).reshape(-1, 3),
    ],
    ids=["empty", "one", "equal", "line", "upright line", "nan", "infinite", "perfect plane"],
)
def test_clouds_that_are_no_road_with_a_hole_give_an_empty_answer(points: np.ndarray, method: str) -> None:
    detection = survey(points, method)
    assert detection.obstacles == ()
    assert detection.labels.shape == (len(points),)
    assert np.isfinite(detection.saliency).all()


def test_points_that_are_not_finite_are_unclassified_and_change_nothing_else() -> None:
    points = bowl(road(8_000))
    broken = np.insert(points, [0, 4_000], np.nan, axis=0)
    detection, clean = survey(broken), survey(points)
    assert detection.labels[[0, 4_001]].tolist() == [PointClass.UNCLASSIFIED] * 2
    assert (np.delete(detection.labels, [0, 4_001]) == clean.labels).all()


def test_a_few_points_far_away_do_not_spoil_the_raster() -> None:
    found = survey(np.vstack([bowl(road(30_000)), [[9.0, 9.0, 0.0], [-9.0, 3.0, 0.2]]])).obstacles
    assert [o.kind for o in found] == [ObstacleKind.POTHOLE]
    assert found[0].length_m == pytest.approx(0.4, abs=0.06)


def test_millimetres_given_as_metres_are_refused_with_a_hint() -> None:
    with pytest.raises(DetectorError, match="millimetres"):
        survey(1000.0 * bowl(road(5_000)))


def test_the_same_survey_gives_the_same_bytes() -> None:
    one, other = survey(bowl(road(8_000))), survey(bowl(road(8_000)))
    assert one.labels.tobytes() == other.labels.tobytes()
    assert one.saliency.tobytes() == other.saliency.tobytes()
    assert one.obstacles[0].points_m.tobytes() == other.obstacles[0].points_m.tobytes()


def test_the_papers_method_marks_the_rim_and_the_walls_of_a_hole_without_noise() -> None:
    points = bowl(road(8_000, noise_m=0.0))
    reach = np.hypot(points[:, 0] / 0.2, points[:, 1] / 0.15)
    detection = survey(points, "saliency")
    wall, away = (reach > 0.92) & (reach < 0.98), reach > 2.0
    assert (detection.labels[wall] == PointClass.NEGATIVE).all()
    assert (detection.labels[away] == PointClass.SAFE_ROAD).mean() > 0.99


def test_a_gap_outside_the_survey_is_no_part_of_a_hole_that_reaches_its_edge() -> None:
    points = bowl(road(40_000), at=(0.62, 0.0))
    round_view = points[np.hypot(points[:, 0], points[:, 1]) < 0.74]
    found = survey(round_view).obstacles
    assert len(found) == 1
    assert found[0].centre_m[0] - 0.5 * found[0].length_m > 0.35
    assert found[0].centre_m[0] < 0.66


def test_a_small_hole_beside_a_large_one_is_reported_too() -> None:
    points = bowl(bowl(road(60_000), at=(-0.25, 0.0)), length_m=0.12, width_m=0.1, depth_m=0.05, at=(0.35, 0.0))
    found = sorted(survey(points).obstacles, key=lambda o: o.centre_m[0])
    assert [o.centre_m[0] for o in found] == pytest.approx([-0.25, 0.35], abs=0.02)
    assert found[1].length_m == pytest.approx(0.12, abs=0.03)


def test_a_steep_hole_of_three_centimetres_is_found_in_a_dense_scan() -> None:
    points = bowl(road(40_000, 0.4, noise_m=0.0005), length_m=0.03, width_m=0.026, depth_m=0.012, at=(0.05, 0.0))
    found = survey(points).obstacles
    assert [o.kind for o in found] == [ObstacleKind.POTHOLE]
    assert found[0].length_m == pytest.approx(0.03, abs=0.005)


@pytest.mark.parametrize("height_m", [-10.0, -0.3, 1.0])
def test_one_stray_point_is_no_obstacle(height_m: float) -> None:
    rng = np.random.default_rng(0)
    points = np.stack([*rng.uniform(0.0, 1.0, (2, 20_000)), rng.normal(0.0, 0.002, 20_000)], axis=1)
    points[100, 2] += height_m
    assert detect(DetectorInput(points.astype(np.float32), None)).obstacles == ()
