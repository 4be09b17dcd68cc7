"""Frames: what goes there comes back, and known values are met."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contract.geometry import LatLon
from vehicle_client.frames import (
    GeoOrigin,
    Matrix,
    apply,
    axis_yaw,
    heading_from_yaw,
    inverse,
    rigid,
    rotation_about_z,
    yaw_from_heading,
    yaw_of,
)
from vehicle_client.sensing.calibration import WHEELBASE_M, VehicleCalibration, curvature_of

angles = st.floats(-20, 20)
metres = st.floats(-5_000, 5_000)
places = st.tuples(metres, metres, st.floats(-500, 500)).map(np.array)


@st.composite
def transforms(draw: st.DrawFn) -> Matrix:
    roll, pitch = draw(st.floats(-1, 1)), draw(st.floats(-1, 1))
    about_x = np.array([[1, 0, 0], [0, math.cos(roll), -math.sin(roll)], [0, math.sin(roll), math.cos(roll)]])
    about_y = np.array([[math.cos(pitch), 0, math.sin(pitch)], [0, 1, 0], [-math.sin(pitch), 0, math.cos(pitch)]])
    return rigid(rotation_about_z(draw(angles)) @ about_y @ about_x, draw(places))


def turned_apart(one_rad: float, other_rad: float) -> float:
    return abs(math.remainder(one_rad - other_rad, 2 * math.pi))


@pytest.mark.parametrize(
    ("heading_deg", "yaw_deg"), [(0, 90), (90, 0), (180, -90), (270, 180), (45, 45), (360, 90), (315, 135)]
)
def test_north_is_a_quarter_turn_and_east_is_none(heading_deg: float, yaw_deg: float) -> None:
    assert yaw_from_heading(math.radians(heading_deg)) == pytest.approx(math.radians(yaw_deg))
    assert turned_apart(heading_from_yaw(math.radians(yaw_deg)), math.radians(heading_deg)) < 1e-12


@given(angles)
def test_heading_and_yaw_are_each_other_s_inverse_and_stay_in_their_ranges(angle_rad: float) -> None:
    yaw, heading = yaw_from_heading(angle_rad), heading_from_yaw(angle_rad)
    assert -math.pi < yaw <= math.pi
    assert 0 <= heading < 2 * math.pi
    assert turned_apart(heading_from_yaw(yaw), angle_rad) < 1e-9
    assert turned_apart(yaw_from_heading(heading), angle_rad) < 1e-9


@given(angles)
def test_a_rotation_says_its_yaw(yaw_rad: float) -> None:
    assert turned_apart(yaw_of(rigid(rotation_about_z(yaw_rad), np.zeros(3))), yaw_rad) < 1e-9


@given(st.one_of(angles, st.floats(-1e-15, 1e-15)))
def test_a_direction_without_a_front_lies_below_pi(yaw_rad: float) -> None:
    axis = axis_yaw(yaw_rad)
    assert 0 <= axis < math.pi
    assert abs(math.remainder(axis - yaw_rad, math.pi)) < 1e-9


@given(transforms(), places)
def test_the_inverse_takes_points_back(a_from_b: Matrix, point_b: Matrix) -> None:
    assert apply(inverse(a_from_b), apply(a_from_b, point_b)) == pytest.approx(point_b, abs=1e-8)
    assert inverse(inverse(a_from_b)) == pytest.approx(a_from_b, abs=1e-8)
    assert inverse(a_from_b) @ a_from_b == pytest.approx(np.eye(4), abs=1e-8)


@given(transforms(), transforms(), places)
def test_transforms_chain_and_keep_distances(a_from_b: Matrix, b_from_c: Matrix, point_c: Matrix) -> None:
    chained = apply(a_from_b @ b_from_c, point_c)
    assert chained == pytest.approx(apply(a_from_b, apply(b_from_c, point_c)), abs=1e-7)
    moved = apply(a_from_b, np.stack([point_c, np.zeros(3)]))
    assert np.linalg.norm(moved[0] - moved[1]) == pytest.approx(np.linalg.norm(point_c), abs=1e-8)


def test_many_points_are_transformed_as_one_is() -> None:
    a_from_b = rigid(rotation_about_z(0.7), np.array([1.0, 2.0, 3.0]))
    points = np.random.default_rng(0).normal(size=(20, 3)).astype(np.float32)
    assert apply(a_from_b, points) == pytest.approx(np.stack([apply(a_from_b, point) for point in points]))
    assert apply(a_from_b, np.empty((0, 3))).shape == (0, 3)


@settings(max_examples=200)
@given(
    st.floats(-90, 90) | st.sampled_from([-90.0, 90.0, 0.0]),
    st.floats(-180, 180) | st.sampled_from([-180.0, 180.0, 0.0]),
    st.floats(-400, 4_000),
    places,
)
def test_a_place_within_five_kilometres_comes_back_through_wgs84(
    latitude: float, longitude: float, altitude_m: float, enu_m: Matrix
) -> None:
    origin = GeoOrigin(LatLon(latitude_deg=latitude, longitude_deg=longitude), altitude_m)
    assert origin.enu(*origin.geodetic(enu_m)) == pytest.approx(enu_m, abs=1e-3)


def test_a_metre_east_of_the_antimeridian_is_a_metre() -> None:
    west_of_it = GeoOrigin(LatLon(latitude_deg=-16.8, longitude_deg=179.99999), 0.0)
    position, _ = west_of_it.geodetic(np.array([5.0, 0.0, 0.0]))
    assert position.longitude_deg < -179.9999
    assert west_of_it.enu(position, 0.0) == pytest.approx([5.0, 0.0, 0.0], abs=1e-4)


def test_a_degree_of_latitude_in_patras_is_111_kilometres_north() -> None:
    # 110 996 m between 38 and 39 degrees on the WGS 84 meridian (a degree at 38.5 degrees).
    origin = GeoOrigin(LatLon(latitude_deg=38.0, longitude_deg=21.7), 0.0)
    north = origin.enu(LatLon(latitude_deg=38.01, longitude_deg=21.7), 0.0)
    assert north[:2] == pytest.approx([0.0, 1_109.9], abs=0.3)


def test_a_wheel_turned_left_bends_the_path_to_the_left() -> None:
    assert curvature_of(0.0) == 0.0
    assert curvature_of(math.atan(WHEELBASE_M / 20)) == pytest.approx(1 / 20)
    assert curvature_of(-0.1) == -curvature_of(0.1) < 0


def test_the_sensor_s_height_is_that_of_its_mount() -> None:
    vehicle = VehicleCalibration(rigid(np.eye(3), np.array([0.5, 0.0, 1.73])), "lidar-64")
    assert vehicle.sensor_height_m == 1.73
    assert apply(vehicle.vehicle_from_sensor, np.array([10.0, 1.0, -1.73])) == pytest.approx([10.5, 1.0, 0.0])
