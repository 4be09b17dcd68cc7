"""The statements of every report, made once for each number of parameters.

Building a statement and its cache key takes SQLAlchemy longer than the database needs to answer it. The numbers of
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
    Select,
    SmallInteger,
    String,
    Uuid,
    and_,
    bindparam,
    func,
    literal_column,
    or_,
    select,
    true,
    tuple_,
)

from server import tables
from server.quadkey import Ranges

T = TypeVar("T")
# The rest is made from these: the served text alone is half of a row.
_DECIDED = [column for column in tables.obstacle.c if column.name not in ("cell", "expires_at", "feature")]
_BIG = ARRAY(BigInteger)
_NOTHING: ColumnClause[int] = literal_column("0")


def padded(values: Sequence[T]) -> tuple[T, ...]:
    """Values repeated up to a power of two."""
    if not values:
        return ()
    size = 1 << (len(values) - 1).bit_length()
    return (*values, *[values[-1]] * (size - len(values)))


@lru_cache
def obstacles_in(spans: int) -> Select[Any]:
    """Obstacles in that many ranges of cells (parameters of `range_values`), by id."""
    return select(*_DECIDED).where(_in_cells(spans)).order_by(tables.obstacle.c.id)


@lru_cache
def evidence_in(spans: int, names: int) -> Select[Any]:
    """Evidence about the obstacles in ranges: of the named witnesses, and all since the first open absence."""
    obstacle, witness = tables.obstacle, tables.witness
    named = witness.c.name.in_([bindparam(f"name{number}") for number in range(names)])
    return (
        select(witness)
        .join(obstacle, and_(obstacle.c.shard == witness.c.shard, obstacle.c.id == witness.c.obstacle_id))
        .where(_in_cells(spans), or_(named, witness.c.latest_at >= obstacle.c.absent_since))
    )


@cache
def obstacles_in_spans() -> Select[Any]:
    """For PostgreSQL: obstacles in ranges of cells (arrays `lows` and `highs`), by id.

    One descent of the index for each range: PostgreSQL plans and checks hundreds of ranges joined by OR in tens of
    milliseconds. Without the OFFSET it would choose another plan.
    """
    lows, highs = bindparam("lows", type_=_BIG), bindparam("highs", type_=_BIG)
    spans = func.unnest(lows, highs).table_valued("low", "high").render_derived()
    here = tables.obstacle.c.cell.between(spans.c.low, spans.c.high)
    inside = select(*_DECIDED).where(here).offset(_NOTHING).lateral()
    return select(inside).select_from(spans.join(inside, true())).order_by(inside.c.id)


@cache
def evidence_about() -> Select[Any]:
    """For PostgreSQL: evidence about obstacles (arrays `shards`, `ids`, `sinces`), of the witnesses in the array
    `names`, and all since the first open absence.
    """
    about = (
        func.unnest(
            bindparam("shards", type_=ARRAY(SmallInteger)),
            bindparam("ids", type_=ARRAY(Uuid)),
            bindparam("sinces", type_=ARRAY(tables.UtcMicroseconds)),
        )
        .table_valued("shard", "id", "since")
        .render_derived()
    )
    witness = tables.witness
    named = witness.c.name == func.any(bindparam("names", type_=ARRAY(String)))
    inside = (
        select(witness)
        .where(witness.c.shard == about.c.shard, witness.c.obstacle_id == about.c.id)
        .where(or_(named, witness.c.latest_at >= about.c.since))
        .offset(_NOTHING)
        .lateral()
    )
    return select(inside).select_from(about.join(inside, true()))


@lru_cache
def tiles_for_update(tiles: int) -> Select[Any]:
    """Rows of that many tiles (`tile0`... with `shard0`...), locked in ascending order."""
    table = tables.tile
    return (
        select(table.c.tile, table.c.version, table.c.lock_seq)
        .where(_are_tiles(tiles))
        .order_by(table.c.shard, table.c.tile)
        .with_for_update()
    )


@lru_cache
def tile_versions(tiles: int) -> Select[Any]:
    """Versions of that many tiles (`tile0`... with `shard0`...)."""
    table = tables.tile
    return select(table.c.tile, table.c.version).where(_are_tiles(tiles))


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


@lru_cache
def places_of(witnesses: int) -> Select[Any]:
    """Last places of that many witnesses (`name0`...)."""
    names: list[ColumnElement[str]] = [bindparam(f"name{number}") for number in range(witnesses)]
    return select(tables.vehicle_place).where(tables.vehicle_place.c.witness.in_(names))


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


def _are_tiles(tiles: int) -> ColumnElement[bool]:
    wanted = [tuple_(bindparam(f"shard{number}"), bindparam(f"tile{number}")) for number in range(tiles)]
    return tuple_(tables.tile.c.shard, tables.tile.c.tile).in_(wanted)
