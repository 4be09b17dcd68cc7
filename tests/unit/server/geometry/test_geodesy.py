"""Nearness on the ellipsoid, decided in the plane where that is good enough."""

from __future__ import annotations

import math

from hypothesis import example, given
from hypothesis import strategies as st

from contract.geometry import LatLon
from server.geometry.geodesy import distance_m, is_within, local_metric, mercator, offset_from

places = st.builds(LatLon, latitude_deg=st.floats(-89.9, 89.9), longitude_deg=st.floats(-180, 180))


@given(places, places, st.floats(0.01, 2e7))
def test_what_is_within_a_radius_on_the_globe_is_what_the_geodesic_says(a: LatLon, b: LatLon, radius_m: float) -> None:
    assert is_within(a, b, radius_m) is (distance_m(a, b) <= radius_m)


@given(places, st.floats(0, 2 * math.pi), st.floats(0, 5_000), st.floats(0.01, 5_000))
@example(LatLon(latitude_deg=10.0, longitude_deg=180.0), 1.5, 100.0, 101.0)
@example(LatLon(latitude_deg=84.999, longitude_deg=-180.0), 4.7, 1_900.0, 1_899.0)
def test_what_is_within_a_radius_is_what_the_geodesic_says(
    centre: LatLon, azimuth_rad: float, apart_m: float, radius_m: float
) -> None:
    other = offset_from(centre, apart_m * math.sin(azimuth_rad), apart_m * math.cos(azimuth_rad))
    assert is_within(centre, other, radius_m) is (distance_m(centre, other) <= radius_m)


@given(
    st.builds(LatLon, latitude_deg=st.floats(-85.05, 85.05), longitude_deg=st.floats(-179, 179)),
    st.floats(0, 2 * math.pi),
    st.floats(0, 4_000),
)
@example(LatLon(latitude_deg=85.05, longitude_deg=0.0), 0.1, 4_000.0)
def test_the_local_metric_is_the_geodesic_but_for_its_stated_error(
    centre: LatLon, azimuth_rad: float, apart_m: float
) -> None:
    other = offset_from(centre, apart_m * math.sin(azimuth_rad), apart_m * math.cos(azimuth_rad))
    metric, true_m = local_metric(centre), distance_m(centre, other)
    assert abs(metric.distance_m(mercator(other.latitude_deg, other.longitude_deg)) - true_m) <= metric.error_m(true_m)
