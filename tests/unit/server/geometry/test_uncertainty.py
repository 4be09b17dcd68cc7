"""Error ellipses against an eigenvalue decomposition."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given

from contract.geometry import PlaneCovariance
from server.geometry.uncertainty import error_ellipse
from tests.unit.server.served import covariances


@given(covariances)
def test_the_axes_are_the_roots_of_the_eigenvalues(covariance: PlaneCovariance) -> None:
    cross = covariance.east_north_m2
    matrix = np.array([[covariance.east_m2, cross], [cross, covariance.north_m2]])
    least, greatest = np.linalg.eigvalsh(matrix)
    ellipse = error_ellipse(covariance)
    assert ellipse.major_sd_m == pytest.approx(math.sqrt(greatest), rel=1e-9, abs=1e-9)
    assert ellipse.minor_sd_m == pytest.approx(math.sqrt(max(0.0, least)), rel=1e-3, abs=1e-3)
    axis = np.array([math.sin(ellipse.azimuth_rad), math.cos(ellipse.azimuth_rad)])
    assert axis @ matrix @ axis == pytest.approx(greatest, rel=1e-9, abs=1e-12)
    assert 0 <= ellipse.azimuth_rad <= math.pi
