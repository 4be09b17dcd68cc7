from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vehicle_client.sources.files import read_cloud
from vehicle_client.sources.frame import LidarFrame, SourceError

COUNT = 40
POINTS = np.random.default_rng(3).normal(0, 15, (COUNT, 3)).astype(np.float32)
RING = np.arange(COUNT) % 32
SINCE_START_S = np.linspace(0, 0.1, COUNT)


def records(order: str) -> np.ndarray:
    made = np.zeros(
        COUNT,
        dtype=[(n, order + k) for n, k in (("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "f4"))]
        + [("ring", order + "u2"), ("time", order + "f8")],
    )
    made["x"], made["y"], made["z"] = POINTS.T
    made["intensity"], made["ring"], made["time"] = 9, RING, SINCE_START_S
    return made


def ply(order: str = "<") -> bytes:
    form = "binary_little_endian" if order == "<" else "binary_big_endian"
    names = ("float x", "float y", "float z", "float intensity", "ushort ring", "double time")
    lines = ["ply", f"format {form} 1.0", f"element vertex {COUNT}", *(f"property {name}" for name in names)]
    return ("\n".join([*lines, "end_header"]) + "\n").encode() + records(order).tobytes()


def pcd() -> bytes:
    """With two bytes of padding and a field of three values, as PCL writes them."""
    kind = np.dtype([("points", records("<").dtype), ("_", "u1", 2), ("normal", "<f4", 3)])
    made = np.zeros(COUNT, dtype=kind)
    made["points"] = records("<")
    lines = [
        "# .PCD v0.7",
        "VERSION 0.7",
        "FIELDS x y z intensity ring time _ normal",
        "SIZE 4 4 4 4 2 8 1 4",
        "TYPE F F F F U F U F",
        "COUNT 1 1 1 1 1 1 2 3",
        f"WIDTH {COUNT}",
        "HEIGHT 1",
        f"POINTS {COUNT}",
        "DATA binary",
    ]
    return ("\n".join(lines) + "\n").encode() + made.tobytes()


FILES = {"little.ply": ply("<"), "big.ply": ply(">"), "cloud.pcd": pcd()}


def read(folder: Path, name: str, data: bytes) -> LidarFrame:
    (folder / name).write_bytes(data)
    return read_cloud(folder / name)


@pytest.mark.parametrize("name", sorted(FILES))
def test_binary_clouds_keep_intensity_ring_and_time(tmp_path: Path, name: str) -> None:
    frame = read(tmp_path, name, FILES[name])
    assert frame.points_m.tolist() == POINTS.tolist()
    assert frame.intensity.tolist() == [9.0] * COUNT
    assert frame.ring.tolist() == RING.tolist()
    assert frame.point_time_s == pytest.approx(SINCE_START_S - 0.1, abs=1e-6)


@pytest.mark.parametrize("name", sorted(FILES))
def test_a_binary_cloud_that_ends_early_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(SourceError, match=f"{name}: the header announces {COUNT} points"):
        read(tmp_path, name, FILES[name][:-1])


@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(name=st.sampled_from(sorted(FILES)), at=st.integers(0, 500), data=st.binary(max_size=20))
def test_corrupt_bytes_give_a_cloud_or_a_clear_error(tmp_path: Path, name: str, at: int, data: bytes) -> None:
    whole = FILES[name]
    try:
        frame = read(tmp_path, name, whole[:at] + data + whole[at + len(data) :])
    except SourceError as error:
        assert name in str(error)  # noqa: PT017  # not raising is as good
        return
    assert frame.points_m.shape[1] == 3


def test_a_scan_of_nuscenes_called_as_those_of_kitti_is_told_by_its_rings(tmp_path: Path) -> None:
    forward, left, up = POINTS.T
    rows = np.column_stack([-left, forward, up, np.full(COUNT, 7.0), RING]).astype("<f4")
    frame = read(tmp_path, "scan.bin", rows.tobytes())
    assert frame.points_m.tolist() == POINTS.tolist()
    assert frame.ring.tolist() == RING.tolist()
