"""One door to all sources: what a path or an address holds is recognised by its content."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol
from urllib.parse import urlsplit

from vehicle_client.frames import GeoOrigin
from vehicle_client.sources.carla_folder import LIDAR
from vehicle_client.sources.carla_recording import CarlaRecording
from vehicle_client.sources.cloud_folder import RATE_HZ, CloudFolder, by_numbers, cloud_files
from vehicle_client.sources.complaints import Complaints
from vehicle_client.sources.files import READERS
from vehicle_client.sources.frame import LidarFrame, SourceError
from vehicle_client.sources.kitti_odometry import KittiOdometry
from vehicle_client.sources.kitti_raw import SWEEPS, KittiRaw
from vehicle_client.sources.live_source import LiveSource, TcpCarrier, UdpCarrier
from vehicle_client.sources.log_source import LogSource
from vehicle_client.sources.mcap_log import McapLog, McapLogs
from vehicle_client.sources.mcap_records import MAGIC
from vehicle_client.sources.ros_bag import RosBag


class CountingSource(Protocol):
    """A source that says how much of it could not be used. A live one has the length 0, since nobody knows it."""

    @property
    def skipped(self) -> int:
        """How many frames, pictures and lines could not be used so far."""
        ...

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[LidarFrame]: ...


@dataclass(frozen=True, slots=True)
class SourceOptions:
    """What a format cannot say of itself."""

    rate_hz: float = RATE_HZ
    """Sweeps a second, for folders of clouds without stamps."""
    start_s: float = 0.0
    """Unix time of the first sweep, where stamps are missing or count from 0 (folders of clouds, KITTI odometry)."""
    ego: int = 0
    """Which vehicle of a CARLA recording."""
    origin: GeoOrigin | None = None
    """Where the world's origin of a CARLA recording lies, if it does not say so itself."""
    topics: Mapping[str, str] = field(default_factory=dict)
    """Topic by role (sweep, image, fix, imu, odometry, motion, velocity), where a recording holds several."""


KNOWN = (
    "a recording in CARLA's layout (egoN/sensor.lidar.ray_cast), a drive of KITTI's raw data (velodyne_points), a "
    "KITTI odometry sequence (velodyne, times.txt), an MCAP file, a ROS bag, a folder of clouds ("
    + ", ".join(sorted(READERS))
    + "), udp://host:port or tcp://host:port"
)

DRIVES_WITHIN = (
    "sequences/*/velodyne",
    f"*/{SWEEPS}",
    f"*/*/{SWEEPS}",
    "*/recording.json",
    "*/metadata.yaml",
    "*/*.mcap",
)
"""What tells that a folder is one of drives."""

SQLITE, ROSBAG = b"SQLite format 3\0", b"#ROSBAG V"


def open_source(place: str | Path, options: SourceOptions | None = None) -> CountingSource:
    """The drive that a path or an address holds; `SourceError` says what was expected."""
    asked = options or SourceOptions()
    if isinstance(place, str) and "://" in place:
        return open_live(place)
    if not 0 < asked.rate_hz < 1000:
        raise SourceError(f"a rate of {asked.rate_hz} sweeps a second: expected more than 0 and less than 1000")
    path = Path(place)
    try:
        if path.is_dir():
            return _open_folder(path, asked)
        if path.is_file():
            return _open_file(path, asked)
    except OSError as error:
        raise SourceError(f"{place}: cannot be read: {error.strerror or error}") from error
    raise SourceError(f"{place}: no such file, folder or address; expected {KNOWN}")


def open_live(address: str) -> LiveSource:
    """A live sensor at `udp://host:port` (listens there) or `tcp://host:port` (connects to it)."""
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise SourceError(f"{address}: {error}; expected udp://host:port or tcp://host:port") from error
    if parts.scheme not in ("udp", "tcp") or not host or port is None or parts.path not in ("", "/"):
        raise SourceError(f"{address}: expected udp://host:port or tcp://host:port")
    complaints = Complaints()
    carrier = UdpCarrier(host, port, complaints) if parts.scheme == "udp" else TcpCarrier(host, port, complaints)
    return LiveSource(carrier, complaints)


def _open_folder(folder: Path, asked: SourceOptions) -> CountingSource:
    if any(folder.glob(f"ego*/{LIDAR}*")):
        return CarlaRecording(folder, asked.ego, asked.origin)
    ego = re.fullmatch(r"ego(\d+)", folder.absolute().name)
    if ego and any(folder.glob(f"{LIDAR}*")):
        return CarlaRecording(folder.absolute().parent, int(ego[1]), asked.origin)
    if (folder / SWEEPS).is_dir():
        return KittiRaw(folder)
    if (folder / "velodyne").is_dir() and (folder / "times.txt").is_file():
        return KittiOdometry(folder, asked.start_s)
    if (folder / "metadata.yaml").is_file() or any(folder.glob("*.db3")) or any(folder.glob("*.mcap")):
        return _open_ros2(folder, asked)
    if cloud_files(folder):
        return CloudFolder(folder, asked.rate_hz, asked.start_s)
    within = sorted(p.parent for pattern in DRIVES_WITHIN for p in folder.glob(pattern))
    if within:
        raise SourceError(f"{folder}: holds {len(within)} drives; name one, such as {within[0]}")
    raise SourceError(f"{folder}: not a drive; expected {KNOWN}")


def _open_ros2(folder: Path, asked: SourceOptions) -> CountingSource:
    """A bag's folder. MCAP files are read by our own reader, which survives what is corrupt."""
    complaints = Complaints()
    files = sorted(folder.glob("*.mcap"), key=by_numbers)
    if len(files) > 1 and not (folder / "metadata.yaml").is_file():
        sound = [file for file in files if _first_bytes(file).startswith(MAGIC)]
        corrupt = ", ".join(file.name for file in files if file not in sound)
        said = f"holds {len(files)} MCAP files" + (f", of which corrupt: {corrupt}" if corrupt else "")
        raise SourceError(f"{folder}: {said}; name one, such as {(sound or files)[0]}")
    if files:
        return LogSource(McapLogs(files, complaints), folder, asked.topics, complaints)
    place = folder
    if not (folder / "metadata.yaml").is_file():
        # The recorder was killed: without its description the files are read alone.
        place = sorted(folder.glob("*.db3"), key=by_numbers)[0]
    return LogSource(RosBag(place, 2, complaints), place, asked.topics, complaints)


def _open_file(path: Path, asked: SourceOptions) -> CountingSource:
    complaints = Complaints()
    start = _first_bytes(path)
    if start.startswith(MAGIC):
        return LogSource(McapLog(path, complaints), path, asked.topics, complaints)
    if start.startswith(ROSBAG):
        return LogSource(RosBag(path, 1, complaints), path, asked.topics, complaints)
    if start == SQLITE:
        return LogSource(RosBag(path, 2, complaints), path, asked.topics, complaints)
    if path.name.lower().endswith(tuple(READERS)):
        return CloudFolder(path, asked.rate_hz, asked.start_s)
    if path.suffix.lower() == ".mcap":
        raise SourceError(f"{path}: corrupt: it does not begin as an MCAP file; expected {KNOWN}")
    raise SourceError(f"{path}: not a drive; expected {KNOWN}")


def _first_bytes(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(16)
