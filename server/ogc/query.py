"""The parameters of `/items` (OGC API - Features part 1, 7.15). Pure."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Literal
from uuid import UUID

from pydantic import AfterValidator, Field, TypeAdapter, ValidationError, model_validator

from contract.geometry import UtcDatetime
from server.geometry.bounds import PATTERN_WITH_HEIGHTS, Bounds
from server.reading.around import Key
from server.reading.cursors import cursor_of, position_of
from server.reading.query import Filters, KindList, Missing, Parameters, StateList

# What the standard's text says in words (7.15.4); that a day exists in its month, a pattern cannot say.
_MOMENT = (
    r"[1-9][0-9]{3}-(0[1-9]|1[0-2])-(0[1-9]|[12][0-9]|3[01])[Tt]([01][0-9]|2[0-3]):[0-5][0-9]:[0-5][0-9]"
    r"(\.[0-9]{1,9})?([Zz]|[-+]([01][0-9]|2[0-3]):[0-5][0-9])"
)
_INTERVAL_PATTERN = rf"^({_MOMENT}|({_MOMENT}|\.\.|)/({_MOMENT}|\.\.|))$"
WHOLE_EARTH = Bounds(-180.0, -90.0, 180.0, 90.0)
MAX_LIMIT = 10_000
_moment = TypeAdapter(UtcDatetime)


@dataclass(frozen=True, slots=True)
class Interval:
    """A closed interval of time; None is open."""

    since: datetime | None
    until: datetime | None

    @classmethod
    def parsed(cls, text: str) -> Interval:
        """From an instant, or an interval `a/b` with `..` or nothing for an open end (7.15.4)."""
        ends = text.split("/")
        if len(ends) > 2:
            raise ValueError("datetime: write an RFC 3339 moment, or an interval as START/END, ../END, START/..")
        parsed = [cls._end(end, is_interval=len(ends) == 2) for end in ends]
        interval = cls(parsed[0], parsed[-1])
        if interval.since is not None and interval.until is not None and interval.since > interval.until:
            raise ValueError("datetime: the interval ends before it begins")
        return interval

    @staticmethod
    def _end(text: str, *, is_interval: bool) -> datetime | None:
        if is_interval and text in ("", ".."):
            return None
        try:
            return _moment.validate_python(text)
        except ValidationError:
            raise ValueError("datetime: write RFC 3339 moments with an offset, as 2026-06-01T12:00:00Z") from None


def _is_bounds(text: str) -> str:
    Bounds.parsed(text, with_heights=True)
    return text


def _is_interval(text: str) -> str:
    Interval.parsed(text)
    return text


class ItemsQuery(Parameters):
    """Query of `/collections/obstacles/items`."""

    limit: Annotated[int, Field(ge=1, le=MAX_LIMIT, description="features in one page")] = 10
    bbox: (
        Annotated[
            str,
            AfterValidator(_is_bounds),
            Field(
                description="west,south,east,north in degrees, or west,south,lowest,east,north,highest with "
                "ellipsoidal heights in metres; west > east runs across the antimeridian",
                json_schema_extra={"pattern": PATTERN_WITH_HEIGHTS},
                examples=["21.70,38.20,21.78,38.28"],
            ),
        ]
        | Missing
    ) = None
    datetime: (
        Annotated[
            str,
            AfterValidator(_is_interval),
            Field(
                description="RFC 3339 moment or interval with `..` for an open end; features that were seen within "
                "it, that is whose time from `first_seen` to `last_seen` meets it",
                json_schema_extra={"pattern": _INTERVAL_PATTERN},
                examples=["2026-06-01T00:00:00Z/.."],
            ),
        ]
        | Missing
    ) = None
    kind: KindList = ()
    state: StateList = ()
    count: Annotated[bool, Field(description="also count all that match (numberMatched), which costs more")] = False
    cursor: Annotated[str, Field(max_length=200, description="from the link `next` of the page before")] | Missing = (
        None
    )
    f: Annotated[Literal["json"], Field(description="format: GeoJSON is the only one")] | Missing = None

    @model_validator(mode="after")
    def _has_a_good_cursor(self) -> ItemsQuery:
        self.after()
        return self

    @property
    def bounds(self) -> Bounds:
        """The box asked for."""
        return WHOLE_EARTH if self.bbox is None else Bounds.parsed(self.bbox, with_heights=True)

    @property
    def filters(self) -> Filters:
        """What the obstacles must be like."""
        interval = Interval(None, None) if self.datetime is None else Interval.parsed(self.datetime)
        return Filters(
            kinds=frozenset(self.kind),
            states=frozenset(self.state) or None,
            seen_since=interval.since,
            first_seen_until=interval.until,
        )

    def after(self) -> Key | None:
        """Where the page begins."""
        return None if self.cursor is None else Key(0.0, *position_of(self.cursor, self._scope(), (UUID,)))

    def cursor_behind(self, key: Key) -> str:
        """The cursor of the page that begins behind a key."""
        return cursor_of(self._scope(), (key.id,))

    def _scope(self) -> str:
        return self.model_dump_json(exclude={"limit", "cursor", "f", "count"})
