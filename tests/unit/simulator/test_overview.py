from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contract.geometry import Kind
from simulator.changes import APPEARED, Change, ChangingStreet
from simulator.overview.figure import overview
from simulator.overview.outlines import outlines
from simulator.overview.sights import LOOK_AHEAD_M, ONLOOKER, PICTURES, Onlooker, Sight, moments
from simulator.readings import EgoFrame, ImageReading
from simulator.record import worlds_of
from simulator.scenario import Scenario, ScenarioPlan, scenario
from simulator.sensors.sensor_rigs import sensor_rig
from simulator.shapes.debris import random_debris
from simulator.shapes.pothole import PotholeShape
from simulator.streets.street import PlacedObstacle

TICK_S = 0.1


@pytest.fixture(scope="module")
def happening() -> Scenario:
    """Two egos that follow each other over the same obstacles, some of which change between them."""
    drawn = scenario(ScenarioPlan(seed=3, egos=2, seconds=20.0))
    assert drawn.changing.changes
    return drawn


def decoded(png: bytes) -> np.ndarray:
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return picture


def colours(picture: np.ndarray) -> int:
    return len(np.unique(picture.reshape(-1, 3), axis=0))


def a_frame(happening: Scenario, ego: int, number: int, *readings: ImageReading) -> EgoFrame:
    at = happening.egos[ego].trajectory.poses(np.array([number * TICK_S]))[0]
    return EgoFrame(number, number * TICK_S, at, at, at, 10.0, 0.0, readings)


def test_moments_have_an_obstacle_close_ahead_and_come_in_the_order_of_egos_and_time(happening: Scenario) -> None:
    chosen = moments(happening, TICK_S)
    assert 2 <= len(chosen) <= PICTURES
    assert chosen == sorted(chosen, key=lambda moment: (moment.ego, moment.frame))
    for moment in chosen:
        at = happening.egos[moment.ego].trajectory.poses(np.array([moment.frame * TICK_S]))[0]
        placed = happening.changing.street.obstacle(moment.obstacle_id)
        ahead, _ = (np.array([placed.x_m, placed.y_m]) - at[:2, 3]) @ at[:2, :2]
        assert LOOK_AHEAD_M / 2 < ahead <= LOOK_AHEAD_M


def test_what_changes_is_shown_before_and_after(happening: Scenario) -> None:
    chosen = moments(happening, TICK_S)
    change = next(c for c in happening.changing.changes if c.obstacle_id in {m.obstacle_id for m in chosen})
    times = [moment.frame * TICK_S for moment in chosen if moment.obstacle_id == change.obstacle_id]
    assert min(times) < change.time_s < max(times)


def test_where_nothing_is_passed_the_middle_of_the_drive_is_shown(happening: Scenario) -> None:
    bare = replace(happening, changing=ChangingStreet(replace(happening.changing.street, obstacles=())))
    chosen = moments(bare, TICK_S)
    assert [(moment.ego, moment.obstacle_id) for moment in chosen] == [(0, 0), (1, 0)]
    assert chosen[0].frame == pytest.approx(10.0 / TICK_S, abs=1)


def test_pictures_of_the_vehicles_own_camera_are_kept(happening: Scenario) -> None:
    rig, chosen = sensor_rig("paper"), [m for m in moments(happening, TICK_S) if m.ego == 0][:1]
    onlooker = Onlooker(chosen, rig, worlds_of(happening), happening.egos[0].mover)
    camera = next(s for s in rig.sensors if s.name.type == "sensor.camera.rgb")
    pixels = np.full((512, 1024, 3), 77, np.uint8)
    onlooker.look(a_frame(happening, 0, chosen[0].frame - 1, ImageReading(camera.name, np.eye(4), pixels)))
    assert onlooker.sights == []
    onlooker.look(a_frame(happening, 0, chosen[0].frame))
    assert onlooker.sights == [], "the camera did not look at this frame"
    onlooker.look(a_frame(happening, 0, chosen[0].frame + 1, ImageReading(camera.name, np.eye(4), pixels)))
    (sight,) = onlooker.sights
    assert sight.pixels is pixels
    assert sight.camera is camera.model
    assert (sight.moment, sight.sweep) == (chosen[0], None)


def test_without_a_camera_a_picture_is_made(happening: Scenario) -> None:
    rig, chosen = sensor_rig("hdl32"), moments(happening, TICK_S)[:1]
    rig = replace(rig, sensors=tuple(s for s in rig.sensors if "camera" not in s.name.type))
    onlooker = Onlooker(chosen, rig, worlds_of(happening), happening.egos[0].mover)
    onlooker.look(a_frame(happening, 0, chosen[0].frame))
    assert onlooker.sights[0].pixels.shape == (ONLOOKER.height_px, ONLOOKER.width_px, 3)
    assert colours(onlooker.sights[0].pixels) > 500


def a_sight(happening: Scenario) -> Sight:
    moment = moments(happening, TICK_S)[0]
    at = happening.egos[moment.ego].trajectory.poses(np.array([moment.frame * TICK_S]))[0]
    pixels = np.full((320, 640, 3), 90, np.uint8)
    seen_from = at @ ONLOOKER.vehicle_from_camera
    return Sight(moment, moment.frame * TICK_S, pixels, ONLOOKER, seen_from, None, np.eye(4))


def test_the_same_recording_gives_the_same_bytes_and_another_one_others(happening: Scenario) -> None:
    sights = [a_sight(happening)]
    once = overview(happening, sights)
    assert once == overview(scenario(happening.plan), sights)
    number = happening.changing.street.obstacles[5].obstacle_id
    late = ChangingStreet(happening.changing.street, (Change(8.0, number, APPEARED),))
    assert once != overview(replace(happening, changing=late), sights)


@pytest.mark.parametrize(("egos", "seconds"), [(1, 0.1), pytest.param(3, 220.0, marks=pytest.mark.soak), (8, 5.0)])
def test_drives_of_any_length_and_number_of_vehicles_can_be_drawn(egos: int, seconds: float) -> None:
    picture = decoded(overview(scenario(ScenarioPlan(seed=4, egos=egos, seconds=seconds)), []))
    assert picture.shape[1] == 1760
    assert 800 < picture.shape[0] < 1600
    assert colours(picture) > 100


def test_an_empty_street_can_be_drawn(happening: Scenario) -> None:
    bare = replace(happening, changing=ChangingStreet(replace(happening.changing.street, obstacles=())))
    assert decoded(overview(bare, [])).shape[1] == 1760


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.booleans(), st.floats(-3.1, 3.1))
def test_outlines_enclose_the_footprint(seed: int, is_hole: bool, yaw_rad: float) -> None:
    shape = PotholeShape.random(seed).relief(seed) if is_hole else random_debris(seed)
    placed = PlacedObstacle(1, Kind.POTHOLE if is_hole else Kind.DEBRIS, 40.0, -3.0, yaw_rad, shape)
    found = outlines(placed)
    area = sum(cv2.contourArea(outline.astype(np.float32)) for outline in found)
    cell_m = max(shape.length_m, shape.width_m) / 160
    edge_m = sum(cv2.arcLength(outline.astype(np.float32), True) for outline in found)
    # The outline runs through the middles of the outermost cells.
    assert area == pytest.approx(shape.footprint_area_m2, abs=edge_m * cell_m + 1e-4)
    # Close by every point of it there is footprint, and there is none.
    around = 2 * max(cell_m, 0.01) * np.array([(np.cos(a), np.sin(a)) for a in np.linspace(0, 2 * np.pi, 24)])
    near = (np.concatenate(found)[:, None] + around).reshape(-1, 2)
    covered = placed.covers(*near.T).reshape(-1, len(around))
    assert covered.any(axis=1).all()
    assert (~covered).any(axis=1).all()
