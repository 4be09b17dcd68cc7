"""Reports: what was measured beside the car arrives at its place on the earth, and what is due is reported once."""

from __future__ import annotations

import math
from dataclasses import replace
from uuid import UUID

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contract.geometry import Kind, LatLon
from contract.observation import Detection, ObservationReport
from detector.passes.inspection import PlaceVerdict
from detector.types import DetectedObstacle, ObstacleKind
from tests.unit.vehicle_client.making import NOON, ORIGIN, PATRAS, feature, planar, pose_at, seen
from vehicle_client.alignment import Alignment
from vehicle_client.frames import GeoOrigin, apply, rotation_about_z
from vehicle_client.positioning.pose import Pose
from vehicle_client.reporting import compose_report, detection_of, known_place

angles = st.floats(-math.pi, math.pi)


@st.composite
def poses(draw: st.DrawFn) -> Pose:
    """A car up to 10 km from where its drive began, its odometry with axes of its own."""
    latitude, longitude = draw(st.floats(-75, 75)), draw(st.floats(-180, 180))
    return pose_at(
        draw(st.floats(-7_000, 7_000)),
        draw(st.floats(-7_000, 7_000)),
        draw(angles),
        odom_from_vehicle=planar(draw(st.floats(-500, 500)), draw(st.floats(-500, 500)), draw(angles)),
        origin=GeoOrigin(LatLon(latitude_deg=latitude, longitude_deg=longitude), draw(st.floats(-100, 3_000))),
    )


@st.composite
def beside(draw: st.DrawFn, pose: Pose) -> DetectedObstacle:
    """An obstacle in `odom`, within sight of the car."""
    centre = apply(pose.odom_from_vehicle, np.array([draw(st.floats(-30, 30)), draw(st.floats(-20, 20)), 0.3]))
    obstacle = seen(yaw_rad=draw(st.floats(0, 3.14)), kind=draw(st.sampled_from(ObstacleKind)))
    return replace(obstacle, centre_m=centre)


def place_of(detection: Detection, report: ObservationReport) -> tuple[LatLon, float]:
    """Where the server puts a detection: east, north, up from the report's origin."""
    origin = GeoOrigin(report.origin.position, report.origin.altitude_m)
    return origin.geodetic(np.array([detection.east_m, detection.north_m, detection.up_m]))


def report_of(pose: Pose, *obstacles: DetectedObstacle) -> ObservationReport:
    return compose_report(UUID(int=5), pose, obstacles, [], pseudonym="ego1", sensor="lidar-64")


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_a_measured_obstacle_arrives_at_its_place_within_a_centimetre(data: st.DataObject) -> None:
    pose = data.draw(poses())
    obstacle = data.draw(beside(pose))
    report = report_of(pose, obstacle)
    truth = apply(pose.enu_from_odom, obstacle.centre_m)
    arrived = pose.origin.enu(*place_of(report.detections[0], report))
    assert np.linalg.norm(arrived - truth) < 0.01


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_a_known_place_is_where_its_detection_was(data: st.DataObject) -> None:
    pose = data.draw(poses())
    obstacle = data.draw(beside(pose))
    report = report_of(pose, obstacle)
    (detection,) = report.detections
    position, altitude_m = place_of(detection, report)
    told = feature(kind=detection.kind)
    geometry = told.geometry.model_copy(update={"coordinates": (position.longitude_deg, position.latitude_deg)})
    properties = told.properties.model_copy(update={"altitude_m": altitude_m, "box": detection.box})
    place = known_place(told.model_copy(update={"geometry": geometry, "properties": properties}), pose, Alignment())
    assert place.centre_odom_m == pytest.approx(obstacle.centre_m, abs=0.01)
    assert abs(math.remainder(place.yaw_rad - obstacle.yaw_rad, math.pi)) < 1e-9
    assert (place.length_m, place.width_m, place.relief_m) == (0.9, 0.7, 0.1)
    assert place.is_negative == obstacle.kind.is_negative


def test_a_known_place_is_as_unsure_as_both_positions_and_moves_with_the_alignment() -> None:
    pose = pose_at(sd_m=1.2)
    alone = known_place(feature(east_m=20), pose, Alignment())
    aligned = known_place(feature(east_m=20), pose, Alignment(np.array([1.0, -2.0]), pairs=2))
    assert alone.place_sd_m == pytest.approx(math.hypot(0.5, 1.2))
    assert aligned.centre_odom_m - alone.centre_odom_m == pytest.approx([1, -2, 0])
    assert aligned.place_sd_m < alone.place_sd_m


def test_yaw_covariance_and_points_are_turned_from_odom_to_east_and_north() -> None:
    # The car drives north; in its odometry that is along x, so odom is turned by a quarter to the left.
    pose = pose_at(heading_rad=0.0, odom_from_vehicle=np.eye(4))
    obstacle = seen(10.0, 2.0, yaw_rad=0.2, points_m=[(0.1, 0.0, -0.05), (0.0, -0.2, 0.0)])
    detection = detection_of(obstacle, pose)
    assert (detection.east_m, detection.north_m) == pytest.approx((-2.0, 10.0), abs=1e-4)
    assert detection.box.yaw_rad == pytest.approx(0.2 + math.pi / 2)
    assert (detection.covariance.east_m2, detection.covariance.north_m2) == pytest.approx((0.0025, 0.01))
    assert detection.points_cm == ((0, 10, -5), (20, 0, 0))


@pytest.mark.parametrize("yaw_rad", [0.0, 1e-17, math.pi - 1e-16, math.pi / 2])
@pytest.mark.parametrize("turned_rad", [0.0, -1e-17, 1e-17, -math.pi / 2, math.pi])
def test_no_yaw_rounds_out_of_the_contract(yaw_rad: float, turned_rad: float) -> None:
    pose = replace(pose_at(), enu_from_odom=planar(0, 0, turned_rad))
    assert 0 <= detection_of(seen(yaw_rad=yaw_rad), pose).box.yaw_rad < math.pi


@given(angles, st.floats(1e-12, 1), st.floats(1e-12, 1), angles)
def test_every_covariance_stays_one_when_it_is_turned(
    turned_rad: float, along_m: float, across_m: float, direction_rad: float
) -> None:
    axes = rotation_about_z(direction_rad)[:2, :2]
    obstacle = seen(covariance_m2=axes @ np.diag([along_m**2, across_m**2]) @ axes.T)
    covariance = detection_of(obstacle, replace(pose_at(), enu_from_odom=planar(0, 0, turned_rad))).covariance
    assert covariance.east_m2 + covariance.north_m2 == pytest.approx(along_m**2 + across_m**2)


def test_sizes_leave_in_millimetres_and_what_was_measured_is_said() -> None:
    detection = detection_of(seen(length_m=0.9004, width_m=0.6996), pose_at())
    assert (detection.box.length_mm, detection.box.width_mm, detection.box.relief_mm) == (900, 700, 100)
    assert (detection.kind, detection.box_sd.relief_mm, detection.box_sd.ln_area) == (Kind.POTHOLE, 4.0, 0.04)
    assert (detection.view.hits, detection.view.frames, detection.view.least_range_m) == (200, 10, 4.0)
    assert (detection.descriptor.name, detection.descriptor.values) == ("shape", {"area_m2": 0.5})


def test_a_report_says_when_and_from_where_and_how_unsure() -> None:
    pose = pose_at(heading_rad=1.0, sd_m=1.5)
    verdicts = [
        (UUID(int=3), PlaceVerdict("absent", 0.9, "even road")),
        (UUID(int=4), PlaceVerdict("not_visible", 0.1, "too few hits")),
    ]
    report = compose_report(UUID(int=5), pose, [], verdicts, pseudonym="ego1", sensor="lidar-64")
    assert (report.report_id, report.observed_at, report.pseudonym) == (UUID(int=5), NOON, "ego1")
    assert report.origin.position.latitude_deg == pytest.approx(PATRAS.latitude_deg, abs=1e-9)
    assert report.origin.heading_rad == pytest.approx(1.0)
    assert (report.origin.covariance.east_m2, report.origin.altitude_sd_m) == (2.25, 2.0)
    assert [(i.obstacle_id.int, i.outcome.value, i.visible_fraction) for i in report.inspections] == [
        (3, "absent", 0.9),
        (4, "not_visible", 0.1),
    ]


def test_the_longer_side_is_the_length_whichever_the_estimator_calls_so() -> None:
    usual, turned = seen(yaw_rad=0.3), seen(length_m=0.7, width_m=0.9, yaw_rad=0.3 + math.pi / 2)
    turned = replace(turned, ln_length_sd=usual.ln_width_sd, ln_width_sd=usual.ln_length_sd)
    one, other = (detection_of(obstacle, pose_at()) for obstacle in (usual, turned))
    assert (one.box.length_mm, one.box.width_mm, one.box_sd) == (other.box.length_mm, other.box.width_mm, other.box_sd)
    assert math.remainder(one.box.yaw_rad - other.box.yaw_rad, math.pi) == pytest.approx(0)


@pytest.mark.parametrize("broken", [{"relief_m": math.nan}, {"volume_m3": -1.0}, {"ln_area_sd": math.inf}])
def test_what_the_contract_refuses_is_left_out_and_the_rest_is_reported(
    broken: dict[str, float], caplog: pytest.LogCaptureFixture
) -> None:
    report = report_of(pose_at(), replace(seen(), **broken), seen(12.0))
    assert len(report.detections) == 1
    assert "cannot be reported" in caplog.text


def test_far_from_where_the_drive_began_up_is_the_car_s_own() -> None:
    # 100 km on, the horizon has turned by 0.9 degrees and the drive's plane is 785 m off.
    altitude_m = ORIGIN.geodetic(np.array([100_000.0, 0.0, 0.0]))[1]
    assert altitude_m > 700
    detection = detection_of(replace(seen(), centre_m=np.array([100_020.0, 0.0, 0.0])), pose_at(100_000.0))
    assert math.hypot(detection.east_m, detection.north_m, detection.up_m) == pytest.approx(20.0, abs=1e-3)
    assert detection.up_m == pytest.approx(20 * 100_000 / 6.38e6, abs=0.01)
