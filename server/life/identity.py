"""Ids of obstacles: UUIDv7 (RFC 9562) whose bits follow from the report, so that a retry or a replay gives the same."""

from __future__ import annotations

import hashlib
from datetime import datetime
from uuid import UUID

_RANDOM_B_BITS = 62


def obstacle_id(received_at: datetime, shard: int, key_id: str, report_id: UUID, index: int) -> UUID:
    """Id of what a report's detection `index` created: milliseconds, version 7, the shard, SHA-256 of its source.

    The 12 bits after the version hold the shard of birth, so that a look-up by id touches one shard.
    """
    milliseconds = int(received_at.timestamp() * 1000)
    digest = hashlib.sha256(f"{key_id}\n{report_id}\n{index}".encode()).digest()
    random_b = int.from_bytes(digest[:8]) & ((1 << _RANDOM_B_BITS) - 1)
    return UUID(int=milliseconds << 80 | 7 << 76 | shard << 64 | 2 << 62 | random_b)


def shard_of_id(identifier: UUID) -> int:
    """The shard of birth that an obstacle's id carries."""
    return identifier.int >> 64 & 0xFFF
