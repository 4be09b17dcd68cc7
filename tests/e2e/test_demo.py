"""The whole loop: `headsup demo` as a user runs it."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

COMMAND = [sys.executable, "-m", "headsup.cli", "demo", "--no-video"]
OBSTACLES = {"pothole 1", "bump", "debris", "pothole 2"}
# Of the slowest machine seen, times four: a guard against hanging, not a measurement.
PATIENCE_S = 480


OTHER_SEEDS = (2, 3, 4, 5)


@pytest.fixture(scope="module", params=[1, *(pytest.param(seed, marks=pytest.mark.soak) for seed in OTHER_SEEDS)])
def demo(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("demo")
    command = [*COMMAND, "--seed", str(request.param), "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0, done.stderr
    return out


@pytest.fixture(scope="module")
def summary(demo: Path) -> dict[str, Any]:
    read: dict[str, Any] = json.loads((demo / "summary.json").read_text())
    return read


def decided(summary: dict[str, Any], car: str, *decisions: str) -> list[tuple[str, str]]:
    return [
        (d["obstacle"], d["decision"]) for d in summary["decisions"] if d["car"] == car and d["decision"] in decisions
    ]


def test_the_first_car_creates_every_obstacle_once_and_nothing_else(summary: dict[str, Any]) -> None:
    created = [(d["car"], d["obstacle"]) for d in summary["decisions"] if d["decision"] == "created"]
    assert sorted(created) == sorted(("ego1", name) for name in OBSTACLES)


def test_the_second_car_confirms_every_obstacle_as_kept(summary: dict[str, Any]) -> None:
    assert {name for name, _ in decided(summary, "ego2", "kept")} == OBSTACLES
    assert not decided(summary, "ego2", "created", "updated", "removed", "rejected")


def test_the_third_car_updates_the_grown_pothole_and_only_that(summary: dict[str, Any]) -> None:
    updated = [d for d in summary["decisions"] if d["decision"] == "updated"]
    assert [(d["car"], d["obstacle"], d["version"]) for d in updated] == [("ego3", "pothole 1", 2)]


def test_two_cars_that_miss_the_filled_pothole_remove_it(summary: dict[str, Any]) -> None:
    missed = [
        (d["car"], d["obstacle"], d["decision"]) for d in summary["decisions"] if d["decision"] in ("absent", "removed")
    ]
    assert missed == [("ego4", "pothole 1", "absent"), ("ego5", "pothole 1", "removed")]


def test_the_second_car_is_warned_eight_seconds_ahead_and_before_its_own_lidar(summary: dict[str, Any]) -> None:
    assert {w["obstacle"] for w in summary["warnings"]} == OBSTACLES
    assert all(w["warned_before_arrival_s"] >= 8.0 for w in summary["warnings"])
    assert all(w["lead_m"] > 50.0 and w["lead_s"] > 0.0 for w in summary["warnings"])


def test_what_is_left_on_the_street_is_written_as_geojson(demo: Path) -> None:
    collection = json.loads((demo / "obstacles.geojson").read_text())
    assert collection["type"] == "FeatureCollection"
    assert sorted(f["properties"]["kind"] for f in collection["features"]) == ["bump", "debris", "pothole"]
    assert all(len(f["geometry"]["coordinates"]) == 2 for f in collection["features"])


def test_the_pictures_are_there_and_the_report_needs_nothing_beside_it(demo: Path) -> None:
    pictures = {p.stem for p in demo.glob("*.png")}
    assert pictures == {
        "ego1-recognition",
        "ego2-early-warning",
        "ego2-marker",
        "ego2-recognition",
        "segmentation",
        "saliency",
    }
    page = (demo / "report.html").read_text(encoding="utf-8")
    # Names of XML vocabularies in the drawings are not fetched.
    assert not re.findall(r"""(?:src|href)=["'](?!data:|#)[^"']+""", page)
    assert page.count("data:image/jpeg;base64,") == len(pictures)


def children(pid: int) -> Iterator[tuple[int, str]]:
    for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        yield int(child), Path(f"/proc/{child}/cmdline").read_text()


@pytest.mark.soak
def test_a_server_killed_in_the_middle_ends_the_demo_with_one_clear_line(tmp_path: Path) -> None:
    with subprocess.Popen(
        [*COMMAND, "--out", str(tmp_path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as demo:
        deadline = time.monotonic() + PATIENCE_S
        while not (tmp_path / "ego1-recognition.png").exists() and time.monotonic() < deadline:
            assert demo.poll() is None
            time.sleep(0.2)
        (server,) = [pid for pid, command in children(demo.pid) if "serve" in command]
        os.kill(server, signal.SIGKILL)
        out, err = demo.communicate(timeout=PATIENCE_S)
    assert demo.returncode == 1
    assert "Traceback" not in out + err
    assert re.fullmatch(
        r"headsup demo: the server stopped in the middle of the demo \(signal 9\); its log is \S+\n", err
    )


def test_a_folder_without_scans_is_refused_before_anything_is_started(tmp_path: Path) -> None:
    command = [*COMMAND, "--data", str(tmp_path), "--out", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 1
    assert (
        done.stderr
        == f"headsup demo: {tmp_path / 'potholes'}: no pothole scans here (expected one or more *.ply files)\n"
    )
