"""The obstacle map on disk, so that after a restart without network the driver is still warned.

Written whole into a new file that then takes the old one's place: a car that is switched off at any moment leaves the
old map or the new one. Gzip of JSON lines: the format, then an obstacle a line.
"""

from __future__ import annotations

import gzip
import logging
import math
import os
import threading
import zlib
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType

from contract.geometry import Message
from contract.obstacle import ObstacleFeature
from vehicle_client.obstacle_map import MOST_REMEMBERED, KnownObstacle, ObstacleMap

_LOG = logging.getLogger(__name__)

SAVED_EVERY_S = 60.0
"""A minute's news is what a crash costs; flash memory is written a megabyte a minute at most."""

VOUCHED_ANEW_S = 3_600.0
"""A map that stays the same is saved again after this, since its age counts in days."""

MAX_BYTES = 64 << 20
"""Of the JSON: ten times what is ever written; a file is trusted no further."""

_HEAD = b'{"headsup_map":1}'


class _Stored(Message):
    """One obstacle, when it was first told, and when the server last vouched for it (Unix seconds)."""

    feature: ObstacleFeature
    told_s: float
    vouched_s: float


class MapStore:
    """One file with the map. Disk trouble is said in one line of the log, and never raised."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._saved: ObstacleMap | None = None
        self._saved_s = -math.inf
        self._thread: threading.Thread | None = None

    def load(self) -> ObstacleMap:
        """The map as it was saved, not fresh until the server speaks; empty when there is none that can be read."""
        try:
            stored = _read(self._path)
        except FileNotFoundError:
            return ObstacleMap()
        except (OSError, EOFError, zlib.error, ValueError) as error:
            _LOG.warning("the obstacle map in %s is not used: %s", self._path, _in_one_line(error))
            return ObstacleMap()
        known = {s.feature.id: KnownObstacle(s.feature, s.told_s, unvouched_s=s.vouched_s) for s in stored}
        return ObstacleMap(remembered=MappingProxyType(known))

    def save_if_due(self, known: ObstacleMap, now_s: float) -> None:
        """Save a map that has changed, in a thread, at most once a minute; the first one after a minute."""
        if math.isinf(self._saved_s) or now_s < self._saved_s:
            self._saved_s = now_s
        if now_s - self._saved_s >= SAVED_EVERY_S and not self._is_saving():
            self._saved_s = now_s
            self._thread = threading.Thread(target=self._save, args=(known, now_s), name="headsup-map", daemon=True)
            self._thread.start()

    def save(self, known: ObstacleMap, now_s: float) -> None:
        """Save a map if it has changed, and wait until it is on disk: at the end of a drive."""
        if self._thread is not None:
            self._thread.join()
        self._save(known, now_s)

    def _is_saving(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def _save(self, known: ObstacleMap, now_s: float) -> None:
        if self._saved is not None and _is_same(self._saved, known):
            return
        try:
            _write(self._path, known, now_s)
        except OSError as error:
            _LOG.warning("the obstacle map cannot be saved in %s: %s", self._path, _in_one_line(error))
            return
        self._saved = known


def _is_same(a: ObstacleMap, b: ObstacleMap) -> bool:
    """Whether the obstacles are the same, and vouched for at about the same time."""
    is_heard_anew = (b.heard_s or 0.0) - (a.heard_s or 0.0) > VOUCHED_ANEW_S
    return a.obstacles == b.obstacles and a.remembered == b.remembered and not is_heard_anew


def _read(path: Path) -> list[_Stored]:
    with gzip.open(path) as file:
        text = file.read(MAX_BYTES + 1)
    if len(text) > MAX_BYTES:
        raise ValueError("it is too large")
    first, *lines = text.splitlines()
    if first != _HEAD:
        raise ValueError("it is no map of this version")
    return [_Stored.model_validate_json(line) for line in lines[: 2 * MOST_REMEMBERED]]


def _write(path: Path, known: ObstacleMap, now_s: float) -> None:
    heard_s = now_s if known.heard_s is None else known.heard_s
    entries = {**known.remembered, **known.obstacles}.values()
    # One by one: a thread that serialised all at once would hold up the frame loop as long.
    lines = [_line(entry, heard_s) for entry in entries]
    text = b"\n".join([_HEAD, *lines])
    new = path.with_name(f"{path.name}.new")
    try:
        # It says where the car was: for its owner only.
        new.touch(mode=0o600)
        with new.open("wb") as file:
            file.write(gzip.compress(text, compresslevel=1, mtime=0))
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)
    except OSError:
        with suppress(OSError):
            new.unlink()
        raise


def _line(entry: KnownObstacle, heard_s: float) -> bytes:
    vouched_s = heard_s if entry.unvouched_s is None else entry.unvouched_s
    return _Stored(feature=entry.feature, told_s=entry.told_s, vouched_s=vouched_s).model_dump_json().encode()


def _in_one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
