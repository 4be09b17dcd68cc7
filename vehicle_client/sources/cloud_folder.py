"""Sweeps of one folder, a file each, in the order of their names: what remains of many a drive."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vehicle_client.sources.complaints import Complaints
from vehicle_client.sources.files import READERS, read_cloud
from vehicle_client.sources.frame import LidarFrame, SourceError
from vehicle_client.sources.pictures import ENDINGS as PICTURE_ENDINGS
from vehicle_client.sources.pictures import read_picture

CLOUD_FOLDERS = ("velodyne", "lidar", "points", "clouds")
PICTURE_FOLDERS = ("image", "images", "image_2", "image_02", "camera")

RATE_HZ = 10.0
"""Of KITTI's and most other spinning LiDARs."""


class CloudFolder:
    """The clouds of a folder, of its `velodyne` (or `lidar`, `points`, `clouds`), or a single file.

    Sweep i has the stamp `start_s + i / rate_hz`, whether those before it could be read or not. Pictures are those of
    an `image` folder beside it: by equal names, else in order where their number is the same. `SourceError` where there
    are no clouds.
    """

    def __init__(self, place: Path, rate_hz: float = RATE_HZ, start_s: float = 0.0) -> None:
        self._complaints = Complaints()
        self._clouds = [place] if place.is_file() else cloud_files(place)
        if not self._clouds:
            raise SourceError(f"{place}: expected clouds: {', '.join(sorted(READERS))}")
        self._period_s, self._start_s = 1 / rate_hz, start_s
        self._pictures = _pictures(place, self._clouds)

    @property
    def skipped(self) -> int:
        """How many clouds and pictures could not be used so far."""
        return self._complaints.count

    def __len__(self) -> int:
        """Clouds that are there; one that turns out to be corrupt is skipped all the same."""
        return len(self._clouds)

    def __iter__(self) -> Iterator[LidarFrame]:
        for index, path in enumerate(self._clouds):
            try:
                cloud = read_cloud(path)
            except SourceError as error:
                self._complaints.add(str(error))
                continue
            yield LidarFrame(
                self._start_s + index * self._period_s,
                cloud.points_m,
                cloud.intensity,
                cloud.ring,
                image=self._picture(path),
                point_time_s=cloud.point_time_s,
            )

    def _picture(self, cloud: Path) -> NDArray[np.uint8] | None:
        path = self._pictures.get(cloud)
        try:
            return None if path is None else read_picture(path)
        except SourceError as error:
            self._complaints.add(str(error))
            return None


def cloud_files(place: Path) -> list[Path]:
    """The clouds of a folder, or of the sub-folder that holds them, in the order of their names; 2 comes before 10."""
    for folder in (place, *(place / name for name in CLOUD_FOLDERS)):
        found = [p for p in _entries(folder) if p.is_file() and p.name.lower().endswith(tuple(READERS))]
        if found:
            return sorted(found, key=by_numbers)
    return []


def _pictures(place: Path, clouds: list[Path]) -> dict[Path, Path]:
    """The picture of each cloud."""
    if place.is_file():
        return {}
    folders = [parent / name for parent in (place, clouds[0].parent.parent) for name in PICTURE_FOLDERS]
    for folder in folders:
        found = sorted((p for p in _entries(folder) if p.suffix.lower() in PICTURE_ENDINGS), key=by_numbers)
        named = {path.stem: path for path in found}
        paired = {cloud: named[cloud.name.split(".")[0]] for cloud in clouds if cloud.name.split(".")[0] in named}
        if paired:
            return paired
        if found and len(found) == len(clouds):
            return dict(zip(clouds, found, strict=True))
    return {}


def _entries(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError:
        return []


def by_numbers(path: Path) -> tuple[list[tuple[int, str]], str]:
    """A key that sorts names with their numbers by value."""
    words = re.split(r"(\d+)", path.name)
    return [(int(word), "") if word.isdecimal() else (-1, word) for word in words], path.name
