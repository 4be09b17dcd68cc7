"""A drive of KITTI's raw data: `DATE_drive_NNNN_sync` (or `_extract`), as it is unpacked."""

from __future__ import annotations

import bisect
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from vehicle_client.frames import Matrix
from vehicle_client.sources.assembling import Assembler
from vehicle_client.sources.carla_folder import numbered
from vehicle_client.sources.complaints import Complaints
from vehicle_client.sources.files import read_cloud
from vehicle_client.sources.frame import LidarFrame, SourceError
from vehicle_client.sources.kitti_text import (
    LIDAR_FROM_IMU,
    InertialRow,
    numbers_of,
    read_calibration,
    read_inertial,
    read_stamps,
    rigid_of,
)
from vehicle_client.sources.number_text import parse_numbers
from vehicle_client.sources.pictures import read_picture
from vehicle_client.sources.readings import Picture

SWEEPS = "velodyne_points"

CAMERAS = ("image_02", "image_00")
"""Left colour camera, else the left grey one."""


class KittiRaw:
    """The drive of one folder with `velodyne_points`, and `image_02` and `oxts` where they are there.

    Fixes are those of the inertial unit (heading, course and stated accuracy with them), moved to the road below the
    LiDAR by calib_imu_to_velo.txt, which lies in the folder of the day or in the drive's own. `SourceError` if it is
    no such drive.
    """

    def __init__(self, folder: Path) -> None:
        self._complaints = Complaints()
        self._sweeps = self._stamped(folder / SWEEPS, "bin") or self._stamped(folder / SWEEPS, "txt")
        if not self._sweeps:
            raise SourceError(f"{folder}: expected sweeps {SWEEPS}/data/NNNNNNNNNN.bin with a line of timestamps each")
        camera = next((c for c in CAMERAS if (folder / c / "timestamps.txt").is_file()), None)
        self._pictures = self._stamped(folder / camera, "png") if camera else []
        inertial = folder / "oxts"
        self._inertial = self._stamped(inertial, "txt") if (inertial / "timestamps.txt").is_file() else []
        self._lidar_from_imu = _lidar_from_imu(folder)

    @property
    def skipped(self) -> int:
        """How many sweeps, pictures and lines could not be used so far."""
        return self._complaints.count

    def __len__(self) -> int:
        """Sweeps that are there; one that turns out to be corrupt is skipped all the same."""
        return len(self._sweeps)

    def __iter__(self) -> Iterator[LidarFrame]:
        assembler = Assembler(self._complaints)
        pictures, rows = 0, 0
        for stamp_s, path in self._sweeps:
            rows_until = bisect.bisect_right(self._inertial, stamp_s, key=lambda row: row[0])
            for row in self._rows(rows, rows_until):
                assembler.add(row.motion)
                assembler.add(row.fix(self._lidar_from_imu))
            pictures_until = bisect.bisect_right(self._pictures, stamp_s + AT_ONCE_S, key=lambda row: row[0])
            if pictures_until > pictures:
                taken_s, picture = self._pictures[pictures_until - 1]
                assembler.add(Picture(taken_s, lambda picture=picture: read_picture(picture)))  # type: ignore[misc]
            rows, pictures = rows_until, pictures_until
            frame = self._sweep(assembler, stamp_s, path)
            if frame is not None:
                yield frame

    def _sweep(self, assembler: Assembler, stamp_s: float, path: Path) -> LidarFrame | None:
        try:
            cloud = read_cloud(path) if path.suffix == ".bin" else read_text_scan(path)
        except SourceError as error:
            self._complaints.add(str(error))
            return None
        return assembler.add(LidarFrame(stamp_s, cloud.points_m, cloud.intensity))

    def _rows(self, first: int, end: int) -> Iterator[InertialRow]:
        for stamp_s, path in self._inertial[first:end]:
            try:
                yield read_inertial(path, stamp_s)
            except SourceError as error:
                self._complaints.add(str(error))

    def _stamped(self, folder: Path, ending: str) -> list[tuple[float, Path]]:
        """The files of a sensor with their stamps, in the order of time; the number is the line of timestamps.txt."""
        stamps = read_stamps(folder / "timestamps.txt")
        found = []
        for number, path in numbered(folder / "data", ending):
            stamp_s = stamps[number] if number < len(stamps) else None
            if stamp_s is None:
                self._complaints.add(f"{folder / 'timestamps.txt'}: no time in line {number + 1}, for {path.name}")
            else:
                found.append((stamp_s, path))
        return sorted(found)


def read_text_scan(path: Path) -> LidarFrame:
    """A sweep of an `_extract` drive: a line of x, y, z, reflectance a point; `SourceError` if it is not whole."""
    try:
        values = parse_numbers(path.read_bytes())
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror}") from error
    if values is None or not len(values) or len(values) % 4:
        raise SourceError(f"{path}: expected lines of four numbers: x, y, z, reflectance")
    rows = values.reshape(-1, 4)
    return LidarFrame(0.0, rows[:, :3].copy(), intensity=rows[:, 3].copy())


AT_ONCE_S = 0.02
"""The sweep fires the cameras as it looks ahead; the picture's stamp is some milliseconds after the sweep's."""


def _lidar_from_imu(folder: Path) -> Matrix:
    for place in (folder, folder.parent):
        lines = read_calibration(place / "calib_imu_to_velo.txt")
        found = rigid_of(numbers_of(lines.get("R", ""), 9), numbers_of(lines.get("T", ""), 3))
        if found is not None:
            return found
    return np.array(LIDAR_FROM_IMU)
