"""Symmetric 2 x 2 matrices as plain numbers: a report has too few of them for arrays to pay."""

from __future__ import annotations

import math
from typing import NamedTuple

from contract.geometry import PlaneCovariance


class Symmetric(NamedTuple):
    """A symmetric matrix [[xx, xy], [xy, yy]] over (east, north)."""

    xx: float
    xy: float
    yy: float

    def plus(self, other: Symmetric) -> Symmetric:
        """The sum."""
        return Symmetric(self.xx + other.xx, self.xy + other.xy, self.yy + other.yy)

    def widened(self, variance: float) -> Symmetric:
        """The sum with `variance` times the unit matrix."""
        return Symmetric(self.xx + variance, self.xy, self.yy + variance)

    def inverse(self) -> Symmetric:
        """The inverse of a regular matrix."""
        determinant = self.xx * self.yy - self.xy * self.xy
        return Symmetric(self.yy / determinant, -self.xy / determinant, self.xx / determinant)

    def times(self, x: float, y: float) -> tuple[float, float]:
        """The product with a vector."""
        return self.xx * x + self.xy * y, self.xy * x + self.yy * y

    def square(self, x: float, y: float) -> float:
        """The quadratic form of a vector: a squared Mahalanobis distance when this is an inverse covariance."""
        return self.xx * x * x + 2 * self.xy * x * y + self.yy * y * y

    def eigenvalues(self) -> tuple[float, float]:
        """Smaller and larger eigenvalue."""
        mean, half_gap = (self.xx + self.yy) / 2, math.hypot((self.xx - self.yy) / 2, self.xy)
        return mean - half_gap, mean + half_gap

    def floored(self, least: float) -> Symmetric:
        """The same axes with no eigenvalue below `least`."""
        above_x, above_y = self.xx - least, self.yy - least
        if above_x >= 0 and above_y >= 0 and above_x * above_y >= self.xy * self.xy:
            return self
        low, high = self.eigenvalues()
        if high <= least:
            return Symmetric(least, 0.0, least)
        # The projector on the larger eigenvalue's axis is (M - low 1) / (high - low).
        gap = high - low
        px, pxy, py = (self.xx - low) / gap, self.xy / gap, (self.yy - low) / gap
        return Symmetric(least + (high - least) * px, (high - least) * pxy, least + (high - least) * py)


def matrix_m2(covariance: PlaneCovariance) -> Symmetric:
    """A covariance in square metres as a matrix."""
    return Symmetric(covariance.east_m2, covariance.east_north_m2, covariance.north_m2)


def covariance_of(matrix: Symmetric) -> PlaneCovariance:
    """A positive semi-definite matrix as a covariance; rounding beyond perfect correlation is undone."""
    limit = math.sqrt(matrix.xx * matrix.yy)
    within_m2 = max(-limit, min(limit, matrix.xy))
    # SQLite keeps no sign of a zero, PostgreSQL does: added to one, it has none.
    return PlaneCovariance(east_m2=matrix.xx + 0.0, north_m2=matrix.yy + 0.0, east_north_m2=within_m2 + 0.0)


def greatest_sd_m(covariance: PlaneCovariance) -> float:
    """Standard deviation (m) along the axis in which a covariance is widest."""
    east_m2, north_m2 = covariance.east_m2, covariance.north_m2
    return math.sqrt((east_m2 + north_m2) / 2 + math.hypot((east_m2 - north_m2) / 2, covariance.east_north_m2))
