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
    return _tag(hashlib.sha256(repr(about).encode()), marks)


class Tags:
    """`tag` for many answers that are told apart by their obstacles alone."""

    def __init__(self, *about: object) -> None:
        self._begun = hashlib.sha256(repr(about).encode())

    def of(self, marks: Iterable[bytes]) -> str:
        """The tag of a page."""
        return _tag(self._begun.copy(), marks)


def _tag(digest: hashlib._Hash, marks: Iterable[bytes]) -> str:
    digest.update(b"".join(marks))
    return f'W/"{digest.hexdigest()[:24]}"'
