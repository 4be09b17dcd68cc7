"""Values of place and shape that both sides exchange."""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime
from enum import StrEnum
from typing import Annotated

from pydantic import AfterValidator, AwareDatetime, BaseModel, BeforeValidator, ConfigDict, Field


class Message(BaseModel):
    """Base of every message: immutable, no unknown keys, no NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def _to_utc(value: datetime) -> datetime:
    try:
        return value.astimezone(UTC)
    except OverflowError:
        raise ValueError("the time lies outside the years 1 to 9999 in UTC") from None


def _is_rfc_3339(value: object) -> object:
    # Numbers, also in quotes, would be taken for seconds or milliseconds since 1970, whichever is likelier.
    if isinstance(value, int | float) or (isinstance(value, str) and not _RFC_3339.fullmatch(value)):
        raise ValueError("write an RFC 3339 moment with its offset, as 2026-06-01T12:00:00Z (a + is %2B in a query)")
    return value


_RFC_3339 = re.compile(
    r"[0-9]{4}-[0-9]{2}-[0-9]{2}[Tt][0-9]{2}:[0-9]{2}:[0-9]{2}(\.[0-9]{1,9})?([Zz]|[-+][0-9]{2}:[0-9]{2})"
)
UtcDatetime = Annotated[AwareDatetime, BeforeValidator(_is_rfc_3339), AfterValidator(_to_utc)]
"""A moment with its offset, as RFC 3339 on the wire; whatever else is refused, other offsets are converted to UTC."""


class Sign(StrEnum):
    """Whether an obstacle lies below or above the road; association goes by sign."""

    NEGATIVE = "negative"
    POSITIVE = "positive"


class Kind(StrEnum):
    """What an obstacle is; a vote over sightings, since bump and debris are easily confused."""

    POTHOLE = "pothole"
    BUMP = "bump"
    DEBRIS = "debris"

    @property
    def sign(self) -> Sign:
        """Negative for a hole, positive for what stands above the road."""
        return Sign.NEGATIVE if self is Kind.POTHOLE else Sign.POSITIVE


class LatLon(Message):
    """A position on the WGS 84 ellipsoid, in degrees; never a bare tuple."""

    latitude_deg: Annotated[float, Field(ge=-90, le=90)]
    longitude_deg: Annotated[float, Field(ge=-180, le=180)]


class PlaneCovariance(Message):
    """Covariance of an (east, north) position, in square metres (1 sigma)."""

    east_m2: Annotated[float, Field(ge=0, le=1e6)]
    north_m2: Annotated[float, Field(ge=0, le=1e6)]
    east_north_m2: Annotated[float, Field(ge=-1e6, le=1e6)] = 0.0

    def model_post_init(self, _context: object, /) -> None:
        """Refuse a matrix that is not positive semi-definite."""
        if self.east_north_m2**2 > self.east_m2 * self.north_m2 * (1 + 1e-9):
            raise ValueError("covariance is not positive semi-definite: east_north_m2^2 > east_m2 * north_m2")


class Box(Message):
    """Oriented bounding box of an obstacle in the plane of the road, and its depth or height.

    Integer millimetres, so that "exactly 15 %" is exact. `length_mm >= width_mm`; `yaw_rad` is the direction
    of the length, counter-clockwise from east, modulo pi.
    """

    length_mm: Annotated[int, Field(ge=1, le=50_000)]
    width_mm: Annotated[int, Field(ge=1, le=50_000)]
    yaw_rad: Annotated[float, Field(ge=0, lt=math.pi)]
    relief_mm: Annotated[
        int, Field(ge=0, le=10_000, description="depth below the road or height above it, by the kind's sign")
    ]

    def model_post_init(self, _context: object, /) -> None:
        """Refuse a box whose width exceeds its length."""
        if self.width_mm > self.length_mm:
            raise ValueError("width_mm exceeds length_mm: length is the longer side, turn yaw_rad by pi / 2")


class BoxSd(Message):
    """Standard deviations of a box (1 sigma); lengths as deviations of the natural logarithm."""

    ln_length: Annotated[float, Field(ge=0, le=3)]
    ln_width: Annotated[float, Field(ge=0, le=3)]
    ln_area: Annotated[float, Field(ge=0, le=3, description="of ln(length * width); the two correlate")]
    relief_mm: Annotated[float, Field(ge=0, le=5_000)]
