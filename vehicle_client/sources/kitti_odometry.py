"""A sequence of KITTI's odometry benchmark: `sequences/NN`, with `poses/NN.txt` as odometry."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vehicle_client.frames import Matrix, inverse
from vehicle_client.sources.carla_folder import numbered
from vehicle_client.sources.complaints import Complaints
from vehicle_client.sources.files import read_cloud
from vehicle_client.sources.frame import LidarFrame, SourceError
from vehicle_client.sources.kitti_text import VEHICLE_FROM_LIDAR, numbers_of, read_calibration, rigid_of
from vehicle_client.sources.pictures import read_picture
from vehicle_client.sources.stamps import StampGate

CAMERAS = ("image_2", "image_0")
"""Left colour camera, else the left grey one."""


class KittiOdometry:
    """Sweeps of `sequences/NN/velodyne` at the times of times.txt, counted from `start_s` (Unix time).

    Where `poses/NN.txt` (beside `sequences`, or poses.txt in the sequence) and the `Tr` of calib.txt are there, they
    give `odom_from_vehicle`; the poses are the camera's, about its first place. There are no fixes. `SourceError` if
    it is no such sequence.
    """

    def __init__(self, folder: Path, start_s: float = 0.0) -> None:
        self._complaints = Complaints()
        self._folder, self._start_s = folder, start_s
        self._times = _times(folder / "times.txt")
        self._sweeps = numbered(folder / "velodyne", "bin")
        if not self._sweeps:
            raise SourceError(f"{folder}: expected sweeps velodyne/NNNNNN.bin")
        camera = next((c for c in CAMERAS if (folder / c).is_dir()), None)
        self._pictures = dict(numbered(folder / camera, "png")) if camera else {}
        self._poses = self._vehicle_poses()

    @property
    def skipped(self) -> int:
        """How many sweeps, pictures and lines could not be used so far."""
        return self._complaints.count

    def __len__(self) -> int:
        """Sweeps that are there; one that turns out to be corrupt is skipped all the same."""
        return len(self._sweeps)

    def __iter__(self) -> Iterator[LidarFrame]:
        gate = StampGate()
        for number, path in self._sweeps:
            try:
                frame = self._frame(number, path, gate)
            except SourceError as error:
                self._complaints.add(str(error))
                continue
            yield frame

    def _frame(self, number: int, path: Path, gate: StampGate) -> LidarFrame:
        time_s = self._times[number] if number < len(self._times) else None
        if time_s is None:
            raise SourceError(f"{self._folder / 'times.txt'}: no time in line {number + 1}, for {path.name}")
        cloud = read_cloud(path)
        refusal = gate.refusal(self._start_s + time_s)
        if refusal is not None:
            raise SourceError(f"{path}: left out: {refusal}")
        return LidarFrame(
            self._start_s + time_s,
            cloud.points_m,
            cloud.intensity,
            image=self._picture(number),
            odom_from_vehicle=self._poses[number] if number < len(self._poses) else None,
        )

    def _picture(self, number: int) -> NDArray[np.uint8] | None:
        path = self._pictures.get(number)
        try:
            return None if path is None else read_picture(path)
        except SourceError as error:
            self._complaints.add(str(error))
            return None

    def _vehicle_poses(self) -> list[Matrix | None]:
        """`odom_from_vehicle` by frame; none where poses or calibration are missing."""
        name = f"{self._folder.name}.txt"
        places = (self._folder / "poses.txt", self._folder.parent.parent / "poses" / name)
        path = next((p for p in places if p.is_file()), None)
        camera_from_lidar = _transform(read_calibration(self._folder / "calib.txt").get("Tr", ""))
        if path is None or camera_from_lidar is None:
            return []
        vehicle_from_camera = VEHICLE_FROM_LIDAR @ inverse(camera_from_lidar)
        poses: list[Matrix | None] = []
        for number, line in enumerate(path.read_text(errors="replace").splitlines(), start=1):
            pose = _transform(line)
            if pose is None:
                self._complaints.add(f"{path}, line {number}: expected the 12 numbers of a pose")
            poses.append(None if pose is None else vehicle_from_camera @ pose @ inverse(vehicle_from_camera))
        return poses


def _times(path: Path) -> list[float | None]:
    """Seconds of each line, None where it is no number; `SourceError` without the file."""
    try:
        lines = path.read_text(errors="replace").splitlines()
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror}") from error
    values = (numbers_of(line, 1) for line in lines)
    return [None if value is None else float(value[0]) for value in values]


def _transform(text: str) -> Matrix | None:
    """A row-major 3 x 4 rigid transform."""
    values = numbers_of(text, 12)
    if values is None:
        return None
    rows = values.reshape(3, 4)
    return rigid_of(rows[:, :3].ravel(), rows[:, 3])
