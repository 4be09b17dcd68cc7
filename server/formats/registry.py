"""Every format: its media type, how one obstacle and how a page of them is written, and which one a caller wants."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from types import MappingProxyType
from typing import Any

from contract.obstacle import Link, ObstacleFeature
from server.errors import NotAcceptableError
from server.formats import datex, denm, fiware, itis, waze
from server.formats.names import FormatName
from server.reading import collection

Features = Sequence[ObstacleFeature]
GEOJSON = "application/geo+json"


@dataclass(frozen=True, slots=True)
class Format:
    """A representation: `one` writes an obstacle, `page` several with the links of the page, both at a moment."""

    name: FormatName
    media_type: str
    one: Callable[[ObstacleFeature, datetime], bytes]
    page: Callable[[Features, Sequence[Link], datetime], bytes]


def chosen(name: FormatName | None, accept: str | None) -> Format:
    """The format by its name, else the best that the header `Accept` allows (RFC 9110, 12.5.1).

    Raises `NotAcceptableError` when the header allows none.
    """
    if name is not None:
        return FORMATS[name]
    if accept is None or not accept.strip():
        return FORMATS[FormatName.GEOJSON]
    qualities = [(_quality(media_range), media_range) for media_range in accept.lower().split(",")]
    best = max(FORMATS.values(), key=lambda item: _allowed(item, qualities))
    if _allowed(best, qualities) <= (0.0, 0):
        known = ", ".join(item.media_type for item in FORMATS.values())
        raise NotAcceptableError(f"this is served as one of: {known}; send one of these in Accept, or f=NAME")
    return best


def _allowed(item: Format, qualities: Sequence[tuple[float, str]]) -> tuple[float, int]:
    """Quality that the most precise matching range gives a format, and how precise the match is."""
    matches = [
        (precision, quality)
        for quality, media_range in qualities
        if (precision := _precision(item, media_range.partition(";")[0].strip())) > 0
    ]
    precision, quality = max(matches, default=(0, 0.0))
    return (quality, precision) if quality > 0 else (0.0, 0)


def _precision(item: Format, media_range: str) -> int:
    if media_range == item.media_type:
        return 3
    if item.name is not FormatName.GEOJSON:
        return 0
    # GeoJSON is what anybody gets who asks for some JSON, or for anything.
    return {"application/json": 2, "application/*": 1, "*/*": 1}.get(media_range, 0)


def _quality(media_range: str) -> float:
    for parameter in media_range.split(";")[1:]:
        name, _, value = parameter.strip().partition("=")
        if name == "q":
            try:
                return float(value)
            except ValueError:
                return 0.0
    return 1.0


def _json_bytes(value: Any) -> bytes:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":")).encode()


def _geojson_page(features: Features, links: Sequence[Link], _now: datetime) -> bytes:
    return collection.joined([collection.encoded(feature) for feature in features], links)


def _format(name: FormatName, media_type: str, item: Callable[[ObstacleFeature], Any], member: str | None) -> Format:
    """A JSON format: an item for each obstacle, as a bare list or under a member's name."""

    def page(features: Features, _links: Sequence[Link], _now: datetime) -> bytes:
        items = [item(feature) for feature in features]
        return _json_bytes(items if member is None else {member: items})

    return Format(name, media_type, lambda feature, _now: _json_bytes(item(feature)), page)


FORMATS = MappingProxyType(
    {
        item.name: item
        for item in (
            Format(FormatName.GEOJSON, GEOJSON, lambda feature, _now: collection.encoded(feature), _geojson_page),
            _format(FormatName.DENM, "application/vnd.headsup.denm+json", denm.message, "messages"),
            Format(
                FormatName.DATEX,
                "application/vnd.headsup.datex+xml",
                lambda feature, now: datex.publication([feature], now),
                lambda features, _links, now: datex.publication(features, now),
            ),
            _format(FormatName.ITIS, "application/vnd.headsup.itis+json", itis.item, "items"),
            Format(
                FormatName.WAZE,
                "application/vnd.headsup.cifs+json",
                lambda feature, _now: _json_bytes(waze.feed([feature])),
                lambda features, _links, _now: _json_bytes(waze.feed(features)),
            ),
            _format(FormatName.FIWARE, "application/ld+json", fiware.entity, None),
        )
    }
)
