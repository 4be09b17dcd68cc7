"""Names of the formats, as `?f=` takes them."""

from __future__ import annotations

from enum import StrEnum


class FormatName(StrEnum):
    """A representation of obstacles."""

    GEOJSON = "geojson"
    DENM = "denm"
    DATEX = "datex"
    ITIS = "itis"
    WAZE = "waze"
    FIWARE = "fiware"
