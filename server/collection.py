"""The one way that features and collections of them are encoded: what was encoded before is joined as bytes."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from uuid import UUID

from pydantic import TypeAdapter

from contract.obstacle import Link, ObstacleFeature

_links = TypeAdapter(tuple[Link, ...])


def encoded(feature: ObstacleFeature) -> bytes:
    """A feature as it is served."""
    return feature.model_dump_json().encode()


def joined(features: Sequence[bytes], links: Sequence[Link] = ()) -> bytes:
    """Encoded features as a collection; without links there is no such member."""
    tail = b"" if not links else b',"links":' + _links.dump_json(tuple(links), exclude_none=True)
    return b'{"type":"FeatureCollection","features":[' + b",".join(features) + b"]" + tail + b"}"


def mark_of(identifier: UUID, revision: int) -> bytes:
    """What tells an obstacle in a revision from all others."""
    return identifier.bytes + revision.to_bytes(8)


def tag(marks: Iterable[bytes], *about: object) -> str:
    """Weak entity tag of a page: which obstacles in which revision (`mark_of`), and what else tells answers apart."""
    digest = hashlib.sha256(repr(about).encode())
    digest.update(b"".join(marks))
    return f'W/"{digest.hexdigest()[:24]}"'
