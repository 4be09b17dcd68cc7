"""Places of which nothing leaves the car: home, a clinic, a depot. Pure but for reading the file."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from contract.geometry import LatLon
from vehicle_client.area import distance_m

LEAST_RADIUS_M = 150.0
"""A smaller circle names the house that it hides."""


class ZoneError(ValueError):
    """The file of quiet zones cannot be used; the message says what was expected."""


@dataclass(frozen=True, slots=True)
class QuietZone:
    """A circle. Its centre should not be the place to be hidden: who sees where reports end, knows the middle."""

    centre: LatLon
    radius_m: float


def is_hidden(position: LatLon, zones: Collection[QuietZone], *, margin_m: float = 0.0) -> bool:
    """Whether a position lies in a zone, or within `margin_m` of one."""
    return any(distance_m(zone.centre, position) <= zone.radius_m + margin_m for zone in zones)


class _Line(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    latitude_deg: Annotated[float, Field(ge=-90, le=90)]
    longitude_deg: Annotated[float, Field(ge=-180, le=180)]
    radius_m: Annotated[float, Field(ge=LEAST_RADIUS_M, le=50_000)]


_lines = TypeAdapter(tuple[_Line, ...])


def read_zones(path: Path) -> tuple[QuietZone, ...]:
    """Zones of a JSON file: a list of `{"latitude_deg": .., "longitude_deg": .., "radius_m": ..}`. Raises `ZoneError`.

    A file that cannot be read stops the car from reporting at all: silence where it was asked for is worth more.
    """
    try:
        lines = _lines.validate_json(path.read_bytes())
    except OSError as error:
        raise ZoneError(f"{path}: {error.strerror}") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise ZoneError(
            f"{path}: {where}: {first['msg']}; expected a list of "
            f'{{"latitude_deg": 38.2, "longitude_deg": 21.7, "radius_m": 300}}, {LEAST_RADIUS_M:.0f} m or more'
        ) from None
    return tuple(
        QuietZone(LatLon(latitude_deg=line.latitude_deg, longitude_deg=line.longitude_deg), line.radius_m)
        for line in lines
    )
