from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from headsup.detect_command import detect_files, output_names
from simulator.mesh import pose
from simulator.motion import Standing
from simulator.sensors.lidar import LidarModel
from simulator.streets.street import first_light_street
from simulator.world import World

app = typer.Typer()
app.command()(detect_files)


@pytest.fixture(scope="module")
def street_sweep() -> np.ndarray:
    """A sweep 6 m before a pothole of 0.9 x 0.7 x 0.12 m."""
    street = first_light_street(seed=3)
    at = pose(street.obstacle(1).x_m - 6.0, -1.75, 2.37)
    return World(street).sweep(LidarModel(), Standing(at), 0.0, np.random.default_rng(1)).points_m


def run(*arguments: str | Path) -> tuple[int, str]:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, result.stderr


def test_a_pothole_in_a_file_is_found_and_written_down(tmp_path: Path, street_sweep: np.ndarray) -> None:
    np.save(tmp_path / "street.npy", street_sweep)
    code, _ = run(tmp_path / "street.npy", "--out", tmp_path / "out", "--sensor-height", "2.4")
    assert code == 0
    labels, saliency = (np.load(tmp_path / f"out/street.{name}.npy") for name in ("labels", "saliency"))
    assert labels.shape == saliency.shape == (len(street_sweep),)
    assert (labels.dtype, saliency.dtype) == (np.uint8, np.float32)
    assert labels.max() <= 5
    assert (saliency.min() >= 0, saliency.max() <= 1) == (True, True)
    obstacles = json.loads((tmp_path / "out/street.obstacles.json").read_text())
    nearest = min(obstacles, key=lambda o: math.dist(o["centre_m"][:2], (6.0, -0.6)))
    assert nearest["kind"] == "pothole"
    assert math.dist(nearest["centre_m"][:2], (6.0, -0.6)) < 0.6
    assert 0.03 < nearest["depth_m"] < 0.25
    assert set(nearest) == {
        *("kind", "centre_m", "length_m", "width_m", "depth_m", "yaw_rad", "volume_m3", "confidence", "points"),
        "descriptor",
    }
    assert (tmp_path / "out/street.png").read_bytes().startswith(b"\x89PNG")


def test_labels_stay_in_the_order_of_the_input_with_points_that_are_not_finite(
    tmp_path: Path, street_sweep: np.ndarray
) -> None:
    holes = street_sweep.copy()
    holes[::50] = np.nan
    np.save(tmp_path / "holes.npy", holes)
    assert run(tmp_path / "holes.npy", "--out", tmp_path / "out", "--sensor-height", "2.4")[0] == 0
    labels = np.load(tmp_path / "out/holes.labels.npy")
    assert len(labels) == len(holes)
    assert not labels[::50].any()
    assert labels.any()


def test_a_bad_file_is_one_line_and_the_others_go_on(tmp_path: Path, street_sweep: np.ndarray) -> None:
    np.save(tmp_path / "good.npy", street_sweep)
    (tmp_path / "bad.bin").write_bytes(b"123")
    code, complaint = run(tmp_path / "bad.bin", tmp_path / "good.npy", tmp_path / "no.ply", "--out", tmp_path / "out")
    assert code == 1
    lines = [line for line in complaint.splitlines() if line.startswith("headsup detect:")]
    assert len(lines) == 2
    assert "bad.bin" in lines[0]
    assert "no.ply" in lines[1]
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        *("good.labels.npy", "good.obstacles.json", "good.png", "good.saliency.npy")
    ]


def test_a_cloud_that_is_no_street_does_not_crash(tmp_path: Path) -> None:
    np.save(tmp_path / "few.npy", np.zeros((2, 3), dtype=np.float32))
    code, complaint = run(tmp_path / "few.npy", "--out", tmp_path / "out")
    assert code == 1
    assert "few.npy" in complaint


def test_an_out_folder_that_is_a_file_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    code, complaint = run(tmp_path / "any.bin", "--out", tmp_path / "out")
    assert code == 1
    assert "cannot be made" in complaint


def test_both_methods_run(tmp_path: Path, street_sweep: np.ndarray) -> None:
    np.save(tmp_path / "street.npy", street_sweep)
    for method in ("surface", "saliency"):
        assert run(tmp_path / "street.npy", "--out", tmp_path / method, "--method", method)[0] == 0
    surface, saliency = (np.load(tmp_path / m / "street.saliency.npy") for m in ("surface", "saliency"))
    assert not np.array_equal(surface, saliency)


def test_equal_names_in_different_folders_are_told_apart() -> None:
    names = output_names([Path("a/0001.bin"), Path("b/0001.bin"), Path("b/0002.bin"), Path("b/0001.ply")])
    assert list(names.values()) == ["a_0001", "b_0001_bin", "0002", "b_0001_ply"]


PATHS = st.builds(
    lambda folders, stem, ending: Path(*folders, stem + ending),
    st.lists(st.sampled_from(["a", "b", "a_1", "b_1"]), max_size=3),
    st.sampled_from(["1", "a_1", "b_1", "1_bin", "1_2"]),
    st.sampled_from([".bin", ".ply"]),
)


@given(st.lists(PATHS, max_size=12))
def test_no_two_files_share_a_name(files: list[Path]) -> None:
    names = output_names(files)
    assert set(names) == set(files)
    assert len(set(names.values())) == len(names)


def test_a_sweep_without_a_road_is_said_to_show_none(tmp_path: Path, street_sweep: np.ndarray) -> None:
    np.save(tmp_path / "street.npy", street_sweep)
    np.save(tmp_path / "behind.npy", street_sweep[street_sweep[:, 0] < -2.0])
    files = [str(tmp_path / f"{name}.npy") for name in ("street", "behind")]
    result = CliRunner().invoke(app, [*files, "--out", str(tmp_path / "out"), "--sensor-height", "2.4"])
    assert result.exit_code == 0
    assert [line.split(": ")[:2] for line in result.stdout.splitlines()] == [[files[1], "no road in view"]]
