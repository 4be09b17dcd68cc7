"""What the whole life of an obstacle needs: operators' actions, merging, trust, and a log that can be replayed."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "2026_11_22_second_life"
down_revision = "2026_11_22_first_tables"
branch_labels = None
depends_on = None


def upgrade() -> None:
    # One statement each: PostgreSQL adds a column with a constant default without rewriting the table.
    op.add_column("obstacle", sa.Column("inspection_state", sa.String(16), nullable=False, server_default="open"))
    op.add_column("obstacle", sa.Column("distinct_from", sa.JSON, nullable=False, server_default="[]"))
    op.add_column("obstacle", sa.Column("feature", sa.Text))
    op.create_index("obstacle_by_expiry", "obstacle", ["expires_at"])
    op.create_index("event_by_obstacle", "event", ["shard", "obstacle_id"])
    op.add_column("report", sa.Column("tiles", sa.JSON, nullable=False, server_default="{}"))
    op.create_index("report_by_receipt", "report", ["received_at"])
    op.create_table(
        "action",
        sa.Column("id", sa.Uuid, primary_key=True),
        sa.Column("at", sa.BigInteger, nullable=False),
        sa.Column("key_id", sa.String(64), nullable=False),
        sa.Column("kind", sa.String(24), nullable=False),
        sa.Column("shard", sa.SmallInteger, nullable=False),
        sa.Column("obstacle_id", sa.Uuid, nullable=False),
        sa.Column("detail", sa.JSON, nullable=False),
        sa.Column("request_id", sa.String(64)),
        sa.Column("tiles", sa.JSON, nullable=False),
    )
    op.create_index("action_by_time", "action", ["at"])
    op.create_index("action_by_obstacle", "action", ["shard", "obstacle_id"])
    op.create_table(
        "creation",
        sa.Column("shard", sa.SmallInteger, primary_key=True, autoincrement=False),
        sa.Column("obstacle_id", sa.Uuid, primary_key=True),
        sa.Column("witness", sa.String(64), nullable=False),
        sa.Column("created_at", sa.BigInteger, nullable=False),
        sa.Column("outcome", sa.String(16), nullable=False),
    )
    op.create_index("creation_by_witness", "creation", ["witness", "created_at"])
    op.create_index("creation_by_outcome", "creation", ["outcome", "witness"])
    op.create_table(
        "vehicle_place",
        sa.Column("witness", sa.String(64), primary_key=True),
        sa.Column("observed_at", sa.BigInteger, nullable=False),
        sa.Column("latitude_deg", sa.Float(53), nullable=False),
        sa.Column("longitude_deg", sa.Float(53), nullable=False),
        sa.Column("sd_m", sa.Float(53), nullable=False),
    )


def downgrade() -> None:
    for name in ("vehicle_place", "creation", "action"):
        op.drop_table(name)
    op.drop_index("report_by_receipt", "report")
    op.drop_column("report", "tiles")
    op.drop_index("event_by_obstacle", "event")
    op.drop_index("obstacle_by_expiry", "obstacle")
    op.drop_column("obstacle", "feature")
    op.drop_column("obstacle", "distinct_from")
    op.drop_column("obstacle", "inspection_state")
