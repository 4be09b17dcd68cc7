"""What the driver is shown: little, legible, and only where it is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from uuid import UUID

import matplotlib as mpl
import numpy as np
import pytest
import skia
from hypothesis import given, settings
from hypothesis import strategies as st

from contract.geometry import Kind
from tests.unit.vehicle_client.making import camera_ahead
from vehicle_client.alerts import Alerts, Hazard, Stage
from vehicle_client.ar.camera import project
from vehicle_client.ar.renderer import draw
from vehicle_client.ar.scene import BEACON_BEYOND_M, MAX_MARKERS, Scene, compose
from vehicle_client.sensing.calibration import CameraCalibration

NOTHING = np.empty((0, 3))
SIZES = [(640, 360), (1280, 720)]


def camera_of(width_px: int = 1280, height_px: int = 720, fov_deg: float = 70.0) -> CameraCalibration:
    return camera_ahead(width_px, height_px, fov_deg)


def hazard(
    distance_m: float,
    stage: Stage = Stage.WARN,
    *,
    beside_m: float = 0.0,
    kind: Kind = Kind.POTHOLE,
    recognised: bool = False,
    speed_mps: float = 14.0,
    length_m: float = 0.9,
) -> Hazard:
    centre = np.array([distance_m, beside_m, 0.0])
    track = 3 if recognised else None
    arrival_s = distance_m / speed_mps
    return Hazard(
        kind, stage, distance_m, arrival_s, centre, length_m, 0.7, 0.4, beside_m, 0.0, 2.5, UUID(int=1), track
    )


def scene_of(*hazards: Hazard, camera: CameraCalibration | None = None, fresh: bool = True, note: str = "") -> Scene:
    return compose(Alerts(hazards, fresh=fresh), camera or camera_of(), NOTHING, status_note=note)


hazards_ahead = st.lists(
    st.builds(
        hazard,
        st.floats(2, 400),
        st.sampled_from(Stage),
        beside_m=st.floats(-3.5, 3.5),
        kind=st.sampled_from(Kind),
        recognised=st.booleans(),
    ),
    max_size=8,
)


@given(hazards_ahead, st.booleans())
def test_whatever_lies_ahead_little_is_shown_and_its_words_are_short(hazards: list[Hazard], fresh: bool) -> None:
    scene = scene_of(*sorted(hazards, key=lambda h: h.distance_m), fresh=fresh)
    assert len(scene.markers) <= MAX_MARKERS == 3
    assert len(scene.beacons) <= MAX_MARKERS
    if scene.card is not None:
        assert max(len(scene.card.title), len(scene.card.detail)) <= 24
    assert ("not fresh" in scene.status) == (not fresh)


def test_the_card_speaks_of_the_nearest_hazard_that_is_announced() -> None:
    passing, near, far = hazard(8, Stage.MARK), hazard(83, kind=Kind.BUMP), hazard(140, Stage.ADVISE)
    card = scene_of(passing, near, far).card
    assert card is not None
    assert (card.kind, card.group, card.title, card.detail) == (Kind.BUMP, False, "Bump ahead", "80 m · 6 s")
    assert scene_of(passing).card is None
    assert scene_of(hazard(300, Stage.INFO)).card is None


def test_several_of_a_kind_are_a_group() -> None:
    card = scene_of(hazard(60), hazard(70), hazard(80, kind=Kind.DEBRIS)).card
    assert card is not None
    assert card.group


@pytest.mark.parametrize(("distance_m", "said"), [(287.0, "290 m"), (50.1, "50 m"), (47.6, "50 m"), (12.4, "10 m")])
def test_distances_are_said_in_steps_that_do_not_flicker(distance_m: float, said: str) -> None:
    card = scene_of(hazard(distance_m)).card
    assert card is not None
    assert card.detail.startswith(f"{said} · ")


@pytest.mark.parametrize(
    ("stage", "recognised", "marked"),
    [
        (Stage.INFO, False, False),
        (Stage.ADVISE, False, False),
        (Stage.ADVISE, True, True),
        (Stage.WARN, False, True),
        (Stage.MARK, False, True),
    ],
)
def test_the_road_is_marked_from_the_warning_on_or_where_the_own_lidar_sees(
    stage: Stage, recognised: bool, marked: bool
) -> None:
    markers = scene_of(hazard(12, stage, recognised=recognised)).markers
    assert [marker.recognised for marker in markers] == ([recognised] if marked else [])


def test_what_is_about_to_be_passed_fades() -> None:
    (warned,), (passing,) = scene_of(hazard(12)).markers, scene_of(hazard(12, Stage.MARK)).markers
    assert passing.opacity < warned.opacity == 1.0


def test_a_beacon_stands_on_the_road_only_where_the_ring_is_too_small() -> None:
    assert scene_of(hazard(BEACON_BEYOND_M)).beacons == ()
    (beacon,) = scene_of(hazard(BEACON_BEYOND_M + 0.1)).beacons
    foot, _ = project(camera_of(), np.array([[BEACON_BEYOND_M + 0.1, 0, 0]]))
    assert beacon.foot_px == pytest.approx(foot[0])
    assert beacon.head_px[1] + beacon.radius_px < beacon.foot_px[1]
    # At least 20 arcmin, so that it is legible (MIL-STD-411F).
    assert 2 * beacon.radius_px >= camera_of().matrix[1, 1] * math.radians(20 / 60)


@settings(max_examples=50)
@given(st.floats(6, 60), st.floats(-2, 2), st.floats(0.2, 5))
def test_the_ring_runs_around_the_hole_and_never_over_it(distance_m: float, beside_m: float, length_m: float) -> None:
    (marker,) = scene_of(hazard(distance_m, beside_m=beside_m, length_m=length_m)).markers or (None,)
    if marker is None:
        return
    # Back to the road: the ray of a pixel meets z = 0.
    camera = camera_of()
    rays = np.column_stack([marker.outline_px, np.ones(48)]) @ np.linalg.inv(camera.matrix).T
    ground = rays / rays[:, 1:2] * 1.3
    x, y = 1.5 + ground[:, 2] - distance_m, -ground[:, 0] - beside_m
    along, across = x * math.cos(0.4) + y * math.sin(0.4), -x * math.sin(0.4) + y * math.cos(0.4)
    assert ((along / (length_m / 2)) ** 2 + (across / (0.7 / 2)) ** 2 > 1).all()


@pytest.mark.parametrize("beside_m", [30.0, -30.0])
def test_what_the_camera_does_not_see_is_not_drawn(beside_m: float) -> None:
    scene = scene_of(hazard(20, beside_m=beside_m), hazard(1.6, Stage.MARK))
    assert (scene.markers, scene.beacons) == ((), ())


def test_own_points_are_drawn_where_they_are_seen_and_nowhere_else() -> None:
    points = np.array([[12.0, 0.0, 0.0], [-5.0, 0.0, 0.0], [12.0, 50.0, 0.0], [np.nan, 0.0, 0.0]])
    scene = compose(Alerts(), camera_of(), points)
    assert scene.points_px == pytest.approx(project(camera_of(), points[:1])[0])


def test_the_status_counts_and_says_what_is_amiss() -> None:
    assert scene_of().status == "Road clear"
    assert scene_of(hazard(50), note="offline").status == "1 hazard ahead · offline"
    assert scene_of(hazard(50), hazard(60), fresh=False).status == "2 hazards ahead · map not fresh"


# The renderer.


def road_image(width_px: int, height_px: int) -> np.ndarray:
    return np.random.default_rng(1).integers(60, 140, (height_px, width_px, 3), dtype=np.uint8)


def full_scene(camera: CameraCalibration, kind: Kind = Kind.POTHOLE) -> Scene:
    hazards = [hazard(d, beside_m=y, kind=kind) for d, y in ((16, 1.0), (24, -1.5), (40, 0.5), (110, 0.0))]
    alerts = Alerts((hazard(9, Stage.MARK, recognised=True), *hazards), fresh=False)
    return compose(alerts, camera, np.array([[9.0, 0.05 * n, 0.0] for n in range(10)]), status_note="server away")


def large_scene(camera: CameraCalibration, kind: Kind) -> Scene:
    """Humps across the lane, one after the other, and everything that the status can say."""
    stages = ((7, Stage.MARK), (10, Stage.MARK), (16, Stage.WARN), (110, Stage.ADVISE))
    hazards = tuple(hazard(d, stage, kind=kind, length_m=4.0, recognised=d == 7) for d, stage in stages)
    return scene_of(*hazards, camera=camera, fresh=False, note="server away")


def words(scene: Scene) -> Sequence[tuple[str, float]]:
    card = [(scene.card.title, 1.0), (scene.card.detail, 0.86)] if scene.card else []
    return [*card, (scene.status, 0.7)]


@pytest.mark.parametrize(("size", "fov_deg", "kind"), list(product(SIZES, [50.0, 90.0], Kind)))
def test_the_overlay_covers_at_most_a_twentieth_of_the_picture(
    size: tuple[int, int], fov_deg: float, kind: Kind
) -> None:
    image, camera = road_image(*size), camera_of(*size, fov_deg)
    for scene in (full_scene(camera, kind), large_scene(camera, kind)):
        changed = (draw(scene, image) != image).any(axis=2).mean()
        assert 0.001 < changed <= 0.05


@pytest.mark.parametrize(("size", "fov_deg"), list(product(SIZES, [50.0, 90.0])))
def test_every_text_fits_the_frame_in_the_real_font(size: tuple[int, int], fov_deg: float) -> None:
    scene = full_scene(camera_of(*size, fov_deg))
    font_file = mpl.get_data_path() + "/fonts/ttf/DejaVuSans-Bold.ttf"
    typeface = skia.FontMgr.New_Custom_Empty().makeFromFile(font_file)
    for text, share in words(scene):
        assert skia.Font(typeface, share * scene.text_px).measureText(text) < 0.8 * size[0]
    image = np.full((size[1], size[0], 3), 100, np.uint8)
    changed = (draw(scene, image) != image).any(axis=2)
    assert not changed[:, [0, -1]].any(), "nothing touches the sides"
    assert not changed[[0, -1]].any(), "nor top and bottom"


@pytest.mark.parametrize("size", SIZES)
def test_drawing_leaves_its_input_and_paints_the_same_again(size: tuple[int, int]) -> None:
    image = road_image(*size)
    before, scene = image.copy(), full_scene(camera_of(*size))
    once, twice = draw(scene, image), draw(scene, image)
    assert (image == before).all()
    assert (once == twice).all()
    assert (once.shape, once.dtype) == (image.shape, np.uint8)


def test_a_view_of_a_larger_image_is_painted_as_its_copy() -> None:
    view = road_image(1280, 720)[::2, ::2]
    scene = full_scene(camera_of(640, 360))
    assert (draw(scene, view) == draw(scene, view.copy())).all()


def test_kinds_and_groups_have_signs_of_their_own() -> None:
    image = np.full((720, 1280, 3), 100, np.uint8)
    scenes = [scene_of(hazard(60, kind=kind)) for kind in Kind] + [scene_of(hazard(60), hazard(62))]
    signs = [draw(scene, image)[:120, 400:600].tobytes() for scene in scenes]
    assert len(set(signs)) == 4


def test_amber_is_what_others_told_and_red_what_the_own_lidar_sees() -> None:
    image = np.zeros((720, 1280, 3), np.uint8)
    told, own = (draw(scene_of(hazard(12, recognised=seen)), image) for seen in (False, True))
    road = slice(380, 600)
    amber, red = np.array([0x00, 0xB0, 0xFF]), np.array([0x30, 0x3B, 0xFF])
    assert (told[road] == amber).all(axis=2).any()
    assert not (told[road] == red).all(axis=2).any()
    assert (own[road] == red).all(axis=2).any()
    assert not (own[road] == amber).all(axis=2).any()
