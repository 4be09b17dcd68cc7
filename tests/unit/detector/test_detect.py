"""One sweep in, classes and obstacles out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detector.errors import DetectorError
from detector.pipeline import Method, detect, estimate_sensor_height
from detector.road.corridor import find_corridor, road_coordinates
from detector.road.ground import near_ground
from detector.types import DetectorInput, FrameDetection, ObstacleKind, PointClass
from tests.unit.detector.scenes import CARS_AND_WALL, Block, Hole, Lidar, Street, cast

METHODS: tuple[Method, ...] = ("surface", "saliency")
HOLE = Hole(8.0, -1.0, 0.9, 0.7, 0.12)
DEBRIS = Block(9.0, 1.2, 0.5, 0.35, 0.25)


def sweep_of(street: Street, x: float = 0.0, y: float = -1.5, seed: int = 0, **given: float) -> DetectorInput:
    points, odom_from_sensor = cast(street, Lidar(), x, y, seed)
    return DetectorInput(points, 2.4, odom_from_sensor=odom_from_sensor, **given)


def found(detection: FrameDetection, x: float, y: float, within: float = 0.6) -> list[ObstacleKind]:
    return [o.kind for o in detection.obstacles if np.hypot(o.centre_m[0] - x, o.centre_m[1] - y) < within]


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("distance", [8.0, 9.0])
def test_a_pothole_and_debris_are_found_in_one_sweep(seed: int, distance: float) -> None:
    street = Street(holes=(HOLE,), blocks=(DEBRIS, *CARS_AND_WALL))
    near_hole = detect(sweep_of(street, HOLE.x - distance, -1.5, seed))
    assert found(near_hole, distance, HOLE.y + 1.5) == [ObstacleKind.POTHOLE]
    near_debris = detect(sweep_of(street, DEBRIS.x - distance, -1.5, seed))
    assert found(near_debris, distance, DEBRIS.y + 1.5) == [ObstacleKind.DEBRIS]


def test_a_bump_across_the_lane_is_found_and_is_no_debris() -> None:
    street = Street(holes=(Hole(8.0, -1.5, 0.8, 3.0, -0.09, 0.0, 1.0),))
    assert found(detect(sweep_of(street)), 8.0, 0.0) == [ObstacleKind.BUMP]


@pytest.mark.parametrize("x", np.arange(-12.0, 24.0, 2.1))
def test_a_sound_road_with_kerbs_cars_and_a_wall_has_no_obstacle(x: float) -> None:
    assert detect(sweep_of(Street(blocks=CARS_AND_WALL), x, -1.0, seed=7)).obstacles == ()


def test_the_hole_of_a_detection_has_its_place_size_and_labels() -> None:
    sweep = sweep_of(Street(holes=(Hole(6.0, -1.0, 0.9, 0.7, 0.12),)))
    detection = detect(sweep)
    (hole,) = detection.obstacles
    assert hole.centre_m == pytest.approx([6.0, 0.5, -2.4], abs=0.2)
    assert 0.4 < hole.length_m < 1.1
    assert hole.relief_m == pytest.approx(0.12, abs=0.03)
    red = sweep.points_m[detection.labels == PointClass.OBSTACLE]
    assert np.hypot(red[:, 0] - 6.0, red[:, 1] - 0.5).max() < 0.7
    assert (detection.residual_m[detection.labels == PointClass.OBSTACLE] < -0.02).all()


def test_the_road_is_safe_and_what_stands_beside_it_dangerous() -> None:
    sweep = sweep_of(Street(blocks=CARS_AND_WALL), y=0.0)
    points, labels = sweep.points_m, detect(sweep).labels
    road = (np.abs(points[:, 1]) < 3.0) & (points[:, 2] < -2.3) & (np.abs(points[:, 0]) < 15)
    wall = (points[:, 1] > 6.8) & (points[:, 2] > -2.0)
    assert (labels[road] == PointClass.SAFE_ROAD).mean() > 0.97
    assert (labels[wall] == PointClass.OUTSIDE).all()


def test_a_hole_is_on_the_road_ahead_only_if_the_steering_leads_there() -> None:
    x, y = 12.0, 5.5
    street = Street(holes=(Hole(x, y, 1.2, 1.0, 0.15),), crown=0.0, kerb=0.0)
    towards = 2 * y / (x * x + y * y)
    points, _ = cast(street, Lidar(columns=832), 0.0, 0.0, 3)
    assert not found(detect(DetectorInput(points, 2.4)), x, y)
    assert found(detect(DetectorInput(points, 2.4, curvature_per_m=towards)), x, y) == [ObstacleKind.POTHOLE]


@pytest.mark.parametrize("method", METHODS)
def test_the_same_sweep_gives_the_same_bytes(method: Method) -> None:
    sweep = sweep_of(Street(holes=(HOLE,), blocks=CARS_AND_WALL))
    first, second = detect(sweep, method), detect(sweep, method)
    for name in ("labels", "saliency", "residual_m"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()
    assert repr(first.obstacles) == repr(second.obstacles)


@pytest.mark.parametrize("method", METHODS)
def test_the_saliency_method_answers_for_every_point_within_zero_and_one(method: Method) -> None:
    sweep = sweep_of(Street(holes=(HOLE,), blocks=(DEBRIS, *CARS_AND_WALL)))
    detection = detect(sweep, method)
    assert detection.labels.shape == detection.saliency.shape == (len(sweep.points_m),)
    assert detection.labels.dtype == np.uint8
    assert detection.saliency.dtype == np.float32
    assert detection.saliency.min() >= 0.0
    assert detection.saliency.max() <= 1.0
    on_debris = np.hypot(sweep.points_m[:, 0] - 9.0, sweep.points_m[:, 1] - 2.7) < 0.35
    flat = detection.labels == PointClass.SAFE_ROAD
    assert detection.saliency[on_debris].mean() > 3 * np.median(detection.saliency[flat])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "points",
    [
        np.empty((0, 3)),
        np.array([[5.0, 0.0, -2.4]]),
        np.full((500, 3), 3.0),
        np.full((500, 3), np.nan),
        np.full((500, 3), np.inf),
        np.column_stack([np.linspace(2, 30, 400), np.zeros(400), np.full(400, -2.4)]),
        np.random.default_rng(0).normal(size=(2000, 3)) * [20, 20, 3] + [0, 0, 30],
    ],
    ids=["empty", "one", "all equal", "nan", "infinite", "one line", "no road in view"],
)
def test_a_cloud_without_a_road_gives_an_empty_answer(points: np.ndarray, method: Method) -> None:
    detection = detect(DetectorInput(points.astype(np.float32), 2.4), method)
    assert detection.obstacles == ()
    assert len(detection.labels) == len(points)
    assert np.isfinite(detection.saliency).all()


def test_points_that_are_not_finite_are_unclassified_and_change_nothing_else() -> None:
    sweep = sweep_of(Street(holes=(HOLE,)))
    bad = np.array([[np.nan, 0, 0], [5, np.inf, 0], [5, 0, np.nan]], dtype=np.float32)
    clean, mixed = detect(sweep), detect(DetectorInput(np.vstack([bad, sweep.points_m]), 2.4))
    assert (mixed.labels[:3] == PointClass.UNCLASSIFIED).all()
    assert (mixed.saliency[:3] == 0.0).all()
    assert (mixed.labels[3:] == clean.labels).all()
    assert repr(mixed.obstacles) == repr(clean.obstacles)


def test_millimetres_given_as_metres_are_refused_with_a_hint() -> None:
    sweep = sweep_of(Street())
    with pytest.raises(DetectorError, match="millimetres"):
        detect(DetectorInput(sweep.points_m * 1000, 2.4))


@pytest.mark.parametrize(
    ("points", "height", "hint"),
    [
        (np.zeros((5, 2), dtype=np.float32), 2.4, r"\(N, 3\)"),
        (np.zeros((5, 3), dtype=np.float32), float("nan"), "sensor_height_m"),
        (np.zeros((5, 3), dtype=np.float32), -1.0, "sensor_height_m"),
    ],
)
def test_what_cannot_be_a_sweep_is_refused(points: np.ndarray, height: float, hint: str) -> None:
    with pytest.raises(DetectorError, match=hint):
        detect(DetectorInput(points, height))


@pytest.mark.parametrize("height", [1.7, 2.4])
def test_the_sensors_height_is_estimated_from_the_road_around_it(height: float) -> None:
    points, _ = cast(Street(blocks=CARS_AND_WALL), Lidar(height=height), 0.0, -1.0, 1)
    assert estimate_sensor_height(points) == pytest.approx(height, abs=0.06)


def test_without_ground_there_is_no_height() -> None:
    with pytest.raises(DetectorError, match="no ground"):
        estimate_sensor_height(np.zeros((100, 3), dtype=np.float32))


@settings(max_examples=50, deadline=None)
@given(st.floats(-0.05, 0.05), st.floats(-15, 30), st.floats(-5, 5))
def test_road_coordinates_are_the_arc_and_the_offset_of_a_circle(curvature: float, along: float, across: float) -> None:
    if abs(curvature) < 1e-6:
        point = np.array([[along, across, 0.0]])
    else:
        radius = 1.0 / curvature - across
        angle = along * curvature
        point = np.array([[radius * np.sin(angle), 1.0 / curvature - radius * np.cos(angle), 0.0]])
    s, d = road_coordinates(point, curvature)
    assert s[0] == pytest.approx(along, abs=1e-3)
    assert d[0] == pytest.approx(across, abs=1e-3)


def test_kerbs_bound_the_corridor_and_one_thing_on_the_road_does_not() -> None:
    points, _ = cast(Street(blocks=(DEBRIS,)), Lidar(), 0.0, -1.0, 2)
    points = points.astype(np.float64)
    corridor = find_corridor(near_ground(points, 2.4, 0.0), 0.0)
    assert corridor.left_m == pytest.approx(4.5, abs=0.3)
    assert corridor.right_m == pytest.approx(-2.5, abs=0.3)
