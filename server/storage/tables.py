"""The tables, the same on SQLite and PostgreSQL: no sequences, no foreign keys between sharded tables."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from typing import Any

from sqlalchemy import (
    BigInteger,
    Column,
    Dialect,
    Float,
    Index,
    Integer,
    MetaData,
    SmallInteger,
    String,
    Table,
    Text,
    TypeDecorator,
    Uuid,
)
from sqlalchemy.types import UserDefinedType

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


class UtcMicroseconds(TypeDecorator[datetime]):
    """A moment as microseconds since 1970 in a 64-bit integer: exact, ordered, and the same on every engine."""

    impl = BigInteger
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> int | None:
        """To the database."""
        return None if value is None else (value - _EPOCH) // timedelta(microseconds=1)

    def process_result_value(self, value: int | None, dialect: Dialect) -> datetime | None:
        """From the database."""
        return None if value is None else _EPOCH + timedelta(microseconds=value)


class JsonText(UserDefinedType[str]):
    """A JSON column whose text is made and read by pydantic: nothing is parsed twice on the way of every report."""

    cache_ok = True

    def get_col_spec(self, **_: object) -> str:
        """The column's type in SQL."""
        return "JSON"


class JsonValue(TypeDecorator[Any]):
    """A JSON column as a Python value, for what is rarely read or written."""

    impl = JsonText
    cache_ok = True

    def process_bind_param(self, value: Any, dialect: Dialect) -> str:
        """To the database."""
        return json.dumps(value)

    def process_result_value(self, value: str | None, dialect: Dialect) -> Any:
        """From the database."""
        return None if value is None else json.loads(value)


metadata = MetaData()

# Lock, version and order of all writes in an area: see `server_rules`, 1.
tile = Table(
    "tile",
    metadata,
    Column("shard", SmallInteger, primary_key=True, autoincrement=False),
    Column("tile", BigInteger, primary_key=True, autoincrement=False),
    Column("version", BigInteger, nullable=False),
    Column("lock_seq", BigInteger, nullable=False),
)

obstacle = Table(
    "obstacle",
    metadata,
    Column("shard", SmallInteger, primary_key=True, autoincrement=False),
    Column("id", Uuid, primary_key=True),
    Column("cell", BigInteger, nullable=False),
    Column("kind", String(16), nullable=False),
    Column("kind_votes", JsonText, nullable=False),
    Column("state", String(16), nullable=False),
    Column("version", Integer, nullable=False),
    Column("revision", Integer, nullable=False),
    Column("latitude_deg", Float(53), nullable=False),
    Column("longitude_deg", Float(53), nullable=False),
    Column("born_latitude_deg", Float(53), nullable=False),
    Column("born_longitude_deg", Float(53), nullable=False),
    Column("east_m2", Float(53), nullable=False),
    Column("north_m2", Float(53), nullable=False),
    Column("east_north_m2", Float(53), nullable=False),
    Column("altitude_m", Float(53), nullable=False),
    Column("altitude_sd_m", Float(53), nullable=False),
    Column("shape", JsonText, nullable=False),
    Column("sizes", JsonText, nullable=False),
    Column("confidence", Float(53), nullable=False),
    Column("as_of", UtcMicroseconds, nullable=False),
    Column("expires_at", UtcMicroseconds, nullable=False),
    Column("first_seen", UtcMicroseconds, nullable=False),
    Column("last_seen", UtcMicroseconds, nullable=False),
    Column("sightings", Integer, nullable=False),
    Column("witness_count", Integer, nullable=False),
    Column("absent_since", UtcMicroseconds),
    Column("succeeds", Uuid),
    Column("merged_into", Uuid),
    Column("removed_at", UtcMicroseconds),
    Column("removed_reason", String(16)),
    # What an operator noted of it, and the obstacles that one report saw beside it (they never merge with it).
    Column("inspection_state", String(16), nullable=False, server_default="open"),
    Column("distinct_from", JsonText, nullable=False, server_default="[]"),
    # As it is served, made once for each revision; none in rows of an older schema.
    Column("feature", Text),
    Index("obstacle_by_cell", "cell"),
    Index("obstacle_by_expiry", "expires_at"),
)

# Versions that were replaced: what the obstacle looked like before.
obstacle_version = Table(
    "obstacle_version",
    metadata,
    Column("shard", SmallInteger, primary_key=True, autoincrement=False),
    Column("obstacle_id", Uuid, primary_key=True),
    Column("version", Integer, primary_key=True, autoincrement=False),
    Column("shape", JsonValue, nullable=False),
    Column("replaced_at", UtcMicroseconds, nullable=False),
)

witness = Table(
    "witness",
    metadata,
    Column("shard", SmallInteger, primary_key=True, autoincrement=False),
    Column("obstacle_id", Uuid, primary_key=True),
    Column("name", String(64), primary_key=True),
    Column("seen_at", JsonText, nullable=False),
    Column("absent_at", UtcMicroseconds),
    Column("latest_at", UtcMicroseconds, nullable=False),
)

# History, outbox and replay of what was pushed, in one.
event = Table(
    "event",
    metadata,
    Column("shard", SmallInteger, primary_key=True, autoincrement=False),
    Column("tile", BigInteger, primary_key=True, autoincrement=False),
    Column("seq", BigInteger, primary_key=True, autoincrement=False),
    Column("obstacle_id", Uuid, nullable=False),
    Column("body", Text, nullable=False),
    Column("written_at", UtcMicroseconds, nullable=False),
    Index("event_by_obstacle", "shard", "obstacle_id"),
)

# The observation log: what was sent, and what was answered.
report = Table(
    "report",
    metadata,
    Column("key_id", String(64), primary_key=True),
    Column("report_id", Uuid, primary_key=True),
    Column("body_sha256", String(64), nullable=False),
    Column("witness", String(64), nullable=False),
    Column("observed_at", UtcMicroseconds, nullable=False),
    Column("received_at", UtcMicroseconds, nullable=False),
    Column("body", Text, nullable=False),
    Column("answer", Text, nullable=False),
    # The locked tiles with their `lock_seq`: the order in which reports about one place were decided.
    Column("tiles", JsonText, nullable=False, server_default="{}"),
    Index("report_by_receipt", "received_at"),
)

# What was decided without a report: by operators (the audit log), and by the sweeper of expired obstacles.
action = Table(
    "action",
    metadata,
    Column("id", Uuid, primary_key=True),
    Column("at", UtcMicroseconds, nullable=False),
    Column("key_id", String(64), nullable=False),
    Column("kind", String(24), nullable=False),
    Column("shard", SmallInteger, nullable=False),
    Column("obstacle_id", Uuid, nullable=False),
    Column("detail", JsonValue, nullable=False),
    Column("request_id", String(64)),
    Column("tiles", JsonValue, nullable=False),
    Index("action_by_time", "at"),
    Index("action_by_obstacle", "shard", "obstacle_id"),
)

# Who reported an obstacle first, and what became of that: sole, shared, refuted by others, or withdrawn.
creation = Table(
    "creation",
    metadata,
    Column("shard", SmallInteger, primary_key=True, autoincrement=False),
    Column("obstacle_id", Uuid, primary_key=True),
    Column("witness", String(64), nullable=False),
    Column("created_at", UtcMicroseconds, nullable=False),
    Column("outcome", String(16), nullable=False),
    Index("creation_by_witness", "witness", "created_at"),
    Index("creation_by_outcome", "outcome", "witness"),
)

# Where a witness last was, coarse as reported: nobody drives faster than the policy's limit.
vehicle_place = Table(
    "vehicle_place",
    metadata,
    Column("witness", String(64), primary_key=True),
    Column("observed_at", UtcMicroseconds, nullable=False),
    Column("latitude_deg", Float(53), nullable=False),
    Column("longitude_deg", Float(53), nullable=False),
    Column("sd_m", Float(53), nullable=False),
)

api_key = Table(
    "api_key",
    metadata,
    Column("id", Uuid, primary_key=True),
    Column("name", String(64), nullable=False),
    Column("role", String(16), nullable=False),
    Column("sha256", String(64), nullable=False, unique=True),
    Column("created_at", UtcMicroseconds, nullable=False),
    Column("revoked_at", UtcMicroseconds),
)

secret = Table(
    "secret",
    metadata,
    Column("name", String(32), primary_key=True),
    Column("value", String(64), nullable=False),
)
