"""The statements of every report, made once: for PostgreSQL with arrays, for SQLite for each number of parameters.

Building a statement and its cache key takes SQLAlchemy longer than the database needs to answer it. SQLite's numbers of
parameters are powers of two (`padded`), so that there are few statements to make and to prepare.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, lru_cache
from typing import Any, TypeVar

from sqlalchemy import (
    ARRAY,
    BigInteger,
    ColumnClause,
    ColumnElement,
    Double,
    Select,
    SmallInteger,
    String,
    Table,
    TableValuedAlias,
    Uuid,
    and_,
    any_,
    bindparam,
    func,
    insert,
    literal_column,
    or_,
    select,
    true,
    tuple_,
)
from sqlalchemy.sql.dml import Insert

from server.geometry.quadkey import Ranges
from server.storage import tables

T = TypeVar("T")
# The rest is made from these: the served text alone is half of a row.
_DECIDED = [column for column in tables.obstacle.c if column.name not in ("expires_at", "feature")]
_VARIANCE = tables.obstacle.c.east_m2 + tables.obstacle.c.north_m2
_NOTHING: ColumnClause[int] = literal_column("0")


def padded(values: Sequence[T]) -> tuple[T, ...]:
    """Values repeated up to a power of two."""
    if not values:
        return ()
    size = 1 << (len(values) - 1).bit_length()
    return (*values, *[values[-1]] * (size - len(values)))


@lru_cache
def obstacles_in(spans: int) -> Select[Any]:
    """Obstacles in that many ranges of cells (parameters of `range_values`)."""
    return select(*_DECIDED).where(_in_cells(spans))


@lru_cache
def obstacles_afar(spans: int, ids: int) -> Select[Any]:
    """Of the obstacles in that many ranges those with variances above `limit_m2`, and those named (`id0`...)."""
    named = tables.obstacle.c.id.in_([bindparam(f"id{number}", type_=Uuid) for number in range(ids)])
    return select(*_DECIDED).where(_in_cells(spans), or_(bindparam("limit_m2") < _VARIANCE, named))


@cache
def obstacles_reached() -> Select[Any]:
    """For PostgreSQL: obstacles in ranges of cells (arrays `lows`, `highs`), of each those with variances above
    its limit (array `limits_m2`) and those named (array `ids`).

    One descent of the index for each range: PostgreSQL plans and checks hundreds of ranges joined by OR in tens of
    milliseconds. Without the OFFSET it would choose another plan.
    """
    table = tables.obstacle
    spans = _unnested(("lows", BigInteger), ("highs", BigInteger), ("limits_m2", Double))
    named = table.c.id == _any_of("ids", Uuid)
    wanted = and_(table.c.cell.between(spans.c.lows, spans.c.highs), or_(spans.c.limits_m2 < _VARIANCE, named))
    inside = select(*_DECIDED).where(wanted).offset(_NOTHING).lateral()
    return select(inside).select_from(spans.join(inside, true()))


@lru_cache
def evidence_of(pairs: int) -> Select[Any]:
    """Evidence by that many primary keys (`shard0`, `id0`, `name0`...)."""
    table = tables.witness
    wanted = [
        tuple_(bindparam(f"shard{n}"), bindparam(f"id{n}", type_=Uuid), bindparam(f"name{n}")) for n in range(pairs)
    ]
    return select(table).where(tuple_(table.c.shard, table.c.obstacle_id, table.c.name).in_(wanted))


@lru_cache
def evidence_since(obstacles: int) -> Select[Any]:
    """All evidence about that many obstacles (`shard0`, `id0`...) of the time from `since0`... on."""
    table = tables.witness
    return select(table).where(
        or_(
            *(
                and_(
                    table.c.shard == bindparam(f"shard{n}"),
                    table.c.obstacle_id == bindparam(f"id{n}", type_=Uuid),
                    table.c.latest_at >= bindparam(f"since{n}", type_=tables.UtcMicroseconds),
                )
                for n in range(obstacles)
            )
        )
    )


@cache
def evidence_of_arrays() -> Select[Any]:
    """For PostgreSQL: evidence by primary keys (arrays `shards`, `ids`, `names`)."""
    about = _unnested(("shards", SmallInteger), ("ids", Uuid), ("names", String))
    table = tables.witness
    here = and_(table.c.shard == about.c.shards, table.c.obstacle_id == about.c.ids, table.c.name == about.c.names)
    inside = select(table).where(here).offset(_NOTHING).lateral()
    return select(inside).select_from(about.join(inside, true()))


@cache
def evidence_since_arrays() -> Select[Any]:
    """For PostgreSQL: all evidence about obstacles (arrays `shards`, `ids`) of the time from `sinces` on."""
    about = _unnested(("shards", SmallInteger), ("ids", Uuid), ("sinces", tables.UtcMicroseconds))
    table = tables.witness
    here = and_(
        table.c.shard == about.c.shards, table.c.obstacle_id == about.c.ids, table.c.latest_at >= about.c.sinces
    )
    inside = select(table).where(here).offset(_NOTHING).lateral()
    return select(inside).select_from(about.join(inside, true()))


@lru_cache
def tiles_held(tiles: int) -> Select[Any]:
    """Rows of that many tiles (`tile0`... with `shard0`...) in a transaction that holds all of them already."""
    table = tables.tile
    return select(table.c.tile, table.c.version, table.c.lock_seq).where(_are_tiles(tiles))


@cache
def tiles_for_update() -> Select[Any]:
    """For PostgreSQL: rows of tiles (arrays `shards`, `tiles`), locked one after the other in the arrays' order."""
    table = tables.tile
    wanted = _unnested(("shards", SmallInteger), ("tiles", BigInteger))
    here = and_(table.c.shard == wanted.c.shards, table.c.tile == wanted.c.tiles)
    inside = select(table.c.tile, table.c.version, table.c.lock_seq).where(here).with_for_update().lateral()
    return select(inside).select_from(wanted.join(inside, true()))


@cache
def tile_versions_of_arrays() -> Select[Any]:
    """For PostgreSQL: versions of tiles (arrays `shards`, `tiles`)."""
    table = tables.tile
    wanted = _unnested(("shards", SmallInteger), ("tiles", BigInteger))
    here = and_(table.c.shard == wanted.c.shards, table.c.tile == wanted.c.tiles)
    inside = select(table.c.tile, table.c.version).where(here).offset(_NOTHING).lateral()
    return select(inside).select_from(wanted.join(inside, true()))


@lru_cache
def answers_to(reports: int) -> Select[Any]:
    """What was answered to that many reports (`key0`... with `report0`...)."""
    table = tables.report
    report = table.c.report_id.type
    wanted = [
        tuple_(bindparam(f"key{number}"), bindparam(f"report{number}", type_=report)) for number in range(reports)
    ]
    return select(table.c.key_id, table.c.report_id, table.c.body_sha256, table.c.answer).where(
        tuple_(table.c.key_id, table.c.report_id).in_(wanted)
    )


@cache
def answers_to_arrays() -> Select[Any]:
    """For PostgreSQL: what was answered to reports (arrays `key_ids`, `report_ids`)."""
    table = tables.report
    about = _unnested(("key_ids", String), ("report_ids", Uuid))
    here = and_(table.c.key_id == about.c.key_ids, table.c.report_id == about.c.report_ids)
    found = select(table.c.key_id, table.c.report_id, table.c.body_sha256, table.c.answer).where(here)
    inside = found.offset(_NOTHING).lateral()
    return select(inside).select_from(about.join(inside, true()))


@lru_cache
def places_of(witnesses: int) -> Select[Any]:
    """Last places of that many witnesses (`name0`...)."""
    names: list[ColumnElement[str]] = [bindparam(f"name{number}") for number in range(witnesses)]
    return select(tables.vehicle_place).where(tables.vehicle_place.c.witness.in_(names))


@cache
def places_of_arrays() -> Select[Any]:
    """For PostgreSQL: last places of witnesses (array `names`)."""
    table = tables.vehicle_place
    return select(table).where(table.c.witness == _any_of("names", String))


@cache
def insert_of_arrays(table: Table) -> Insert:
    """For PostgreSQL: rows of a table, one array of values for each column."""
    values = _unnested(*((column.name, column.type) for column in table.columns))
    return insert(table).from_select([column.name for column in table.columns], select(*values.c))


def range_values(ranges: Ranges) -> dict[str, int]:
    """Parameters of ranges of cells."""
    return {f"low{number}": low for number, (low, _) in enumerate(ranges)} | {
        f"high{number}": high for number, (_, high) in enumerate(ranges)
    }


def numbered(name: str, values: Sequence[Any]) -> dict[str, Any]:
    """Parameters `name0`, `name1`, ..."""
    return {f"{name}{number}": value for number, value in enumerate(values)}


def _in_cells(spans: int) -> ColumnElement[bool]:
    cell = tables.obstacle.c.cell
    return or_(*(cell.between(bindparam(f"low{number}"), bindparam(f"high{number}")) for number in range(spans)))


def _unnested(*arrays: tuple[str, Any]) -> TableValuedAlias:
    """Rows of arrays of the same length, given as parameters of their names and the types of their members."""
    values = [bindparam(name, type_=ARRAY(member, dimensions=1)) for name, member in arrays]
    return func.unnest(*values).table_valued(*(name for name, _ in arrays)).render_derived()


def _any_of(name: str, member: Any) -> ColumnElement[Any]:
    """One of the values of an array that is given as a parameter of that name."""
    return any_(bindparam(name, type_=ARRAY(member, dimensions=1)))


def _are_tiles(tiles: int) -> ColumnElement[bool]:
    wanted = [tuple_(bindparam(f"shard{number}"), bindparam(f"tile{number}")) for number in range(tiles)]
    return tuple_(tables.tile.c.shard, tables.tile.c.tile).in_(wanted)
