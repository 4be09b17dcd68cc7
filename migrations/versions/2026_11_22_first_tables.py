"""First tables: obstacles with their evidence and history, tiles, events, the observation log, keys."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "2026_11_22_first_tables"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "tile",
        sa.Column("shard", sa.SmallInteger, primary_key=True, autoincrement=False),
        sa.Column("tile", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("version", sa.BigInteger, nullable=False),
        sa.Column("lock_seq", sa.BigInteger, nullable=False),
    )
    op.create_table(
        "obstacle",
        sa.Column("shard", sa.SmallInteger, primary_key=True, autoincrement=False),
        sa.Column("id", sa.Uuid, primary_key=True),
        sa.Column("cell", sa.BigInteger, nullable=False),
        sa.Column("kind", sa.String(16), nullable=False),
        sa.Column("kind_votes", sa.JSON, nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("version", sa.Integer, nullable=False),
        sa.Column("revision", sa.Integer, nullable=False),
        sa.Column("latitude_deg", sa.Float(53), nullable=False),
        sa.Column("longitude_deg", sa.Float(53), nullable=False),
        sa.Column("born_latitude_deg", sa.Float(53), nullable=False),
        sa.Column("born_longitude_deg", sa.Float(53), nullable=False),
        sa.Column("east_m2", sa.Float(53), nullable=False),
        sa.Column("north_m2", sa.Float(53), nullable=False),
        sa.Column("east_north_m2", sa.Float(53), nullable=False),
        sa.Column("altitude_m", sa.Float(53), nullable=False),
        sa.Column("altitude_sd_m", sa.Float(53), nullable=False),
        sa.Column("shape", sa.JSON, nullable=False),
        sa.Column("sizes", sa.JSON, nullable=False),
        sa.Column("confidence", sa.Float(53), nullable=False),
        sa.Column("as_of", sa.BigInteger, nullable=False),
        sa.Column("expires_at", sa.BigInteger, nullable=False),
        sa.Column("first_seen", sa.BigInteger, nullable=False),
        sa.Column("last_seen", sa.BigInteger, nullable=False),
        sa.Column("sightings", sa.Integer, nullable=False),
        sa.Column("witness_count", sa.Integer, nullable=False),
        sa.Column("absent_since", sa.BigInteger),
        sa.Column("succeeds", sa.Uuid),
        sa.Column("merged_into", sa.Uuid),
        sa.Column("removed_at", sa.BigInteger),
        sa.Column("removed_reason", sa.String(16)),
    )
    op.create_index("obstacle_by_cell", "obstacle", ["cell"])
    op.create_table(
        "obstacle_version",
        sa.Column("shard", sa.SmallInteger, primary_key=True, autoincrement=False),
        sa.Column("obstacle_id", sa.Uuid, primary_key=True),
        sa.Column("version", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("shape", sa.JSON, nullable=False),
        sa.Column("replaced_at", sa.BigInteger, nullable=False),
    )
    op.create_table(
        "witness",
        sa.Column("shard", sa.SmallInteger, primary_key=True, autoincrement=False),
        sa.Column("obstacle_id", sa.Uuid, primary_key=True),
        sa.Column("name", sa.String(64), primary_key=True),
        sa.Column("seen_at", sa.JSON, nullable=False),
        sa.Column("absent_at", sa.BigInteger),
        sa.Column("latest_at", sa.BigInteger, nullable=False),
    )
    op.create_table(
        "event",
        sa.Column("shard", sa.SmallInteger, primary_key=True, autoincrement=False),
        sa.Column("tile", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("seq", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("obstacle_id", sa.Uuid, nullable=False),
        sa.Column("body", sa.Text, nullable=False),
        sa.Column("written_at", sa.BigInteger, nullable=False),
    )
    op.create_table(
        "report",
        sa.Column("key_id", sa.String(64), primary_key=True),
        sa.Column("report_id", sa.Uuid, primary_key=True),
        sa.Column("body_sha256", sa.String(64), nullable=False),
        sa.Column("witness", sa.String(64), nullable=False),
        sa.Column("observed_at", sa.BigInteger, nullable=False),
        sa.Column("received_at", sa.BigInteger, nullable=False),
        sa.Column("body", sa.Text, nullable=False),
        sa.Column("answer", sa.Text, nullable=False),
    )
    op.create_table(
        "api_key",
        sa.Column("id", sa.Uuid, primary_key=True),
        sa.Column("name", sa.String(64), nullable=False),
        sa.Column("role", sa.String(16), nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False, unique=True),
        sa.Column("created_at", sa.BigInteger, nullable=False),
        sa.Column("revoked_at", sa.BigInteger),
    )
    op.create_table(
        "secret",
        sa.Column("name", sa.String(32), primary_key=True),
        sa.Column("value", sa.String(64), nullable=False),
    )


def downgrade() -> None:
    for name in ("secret", "api_key", "report", "event", "witness", "obstacle_version", "obstacle", "tile"):
        op.drop_table(name)
