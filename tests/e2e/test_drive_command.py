"""`headsup drive` as a vehicle engineer runs it: a ROS bag in, obstacles at a real server, the next car warned."""

from __future__ import annotations

import errno
import json
import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from typer.testing import CliRunner

from contract.geometry import Kind, LatLon
from contract.obstacle import ObstacleCollection, ObstacleFeature
from headsup.cli import app
from headsup.simulate.street_bags import street
from tests.integration.serving import Served, served
from vehicle_client.area import distance_m
from vehicle_client.sensing.calibration_file import read_calibration
from vehicle_client.sources.opening import SourceOptions, open_source

COMMAND = (sys.executable, "-m", "headsup.cli", "drive")
PATIENCE_S = 240
"""A guard against hanging, not a measurement."""

NEAR_M = 3.0
"""Satellites put this car 1.4 m off; the street's obstacles lie 20 m apart."""

SWEEPS = 50
"""Of the 154 of the real street: five seconds."""

DATA = Path(os.environ.get("HEADSUP_DATA", "../shared/data"))


def drive(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    environment = {name: value for name, value in os.environ.items() if not name.startswith("HEADSUP_")}
    command = [*COMMAND, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False, env=environment)


def counted(path: Path, *arguments: str | Path) -> dict[str, Any]:
    """What a drive that ends well came to."""
    done = drive(*arguments, "--json", path)
    assert done.returncode == 0, done.stderr
    said: dict[str, Any] = json.loads(path.read_text())
    return said


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tried") / "bags"
    made = CliRunner().invoke(app, ["simulate", "bags", "--out", str(folder)])
    assert made.exit_code == 0, made.stderr
    assert sorted(file.name for file in folder.iterdir()) == ["car.toml", "first", "second"]
    return folder


def of(bags: Path, name: str) -> tuple[str | Path, ...]:
    """The arguments for a bag."""
    return (bags / name, "--calibration", bags / "car.toml")


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with served(tmp_path_factory.mktemp("server") / "headsup.sqlite3") as server:
        yield server


@pytest.fixture(scope="module")
def first_drive(bags: Path, server: Served, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("first")
    said = (*of(bags, "first"), "--server", server.address, "--as-if-now", "--state", folder)
    return counted(folder / "counts.json", *said)


def kept_by(server: Served, middle: LatLon) -> tuple[ObstacleFeature, ...]:
    where = {"lat": middle.latitude_deg, "lon": middle.longitude_deg, "radius_m": 500}
    with server.client() as client:
        return tuple(ObstacleCollection.model_validate_json(client.get("/v1/obstacles", params=where).content).features)


def test_a_bag_ends_with_the_street_s_obstacles_at_the_server_and_nothing_else(
    server: Served, first_drive: dict[str, Any]
) -> None:
    along = street()
    kept = kept_by(server, along.position_of(along.obstacles[1].obstacle_id))
    true = {placed.obstacle_id: along.position_of(placed.obstacle_id) for placed in along.obstacles}
    names: list[int] = []
    for feature in kept:
        nearest = min(true, key=lambda i: distance_m(true[i], feature.position))
        assert distance_m(true[nearest], feature.position) < NEAR_M
        assert feature.properties.kind is along.obstacle(nearest).kind
        names.append(nearest)
    assert sorted(names) == sorted(true)
    assert {feature.properties.kind for feature in kept} == {Kind.POTHOLE, Kind.BUMP, Kind.DEBRIS}
    assert first_drive["answers"] == {"accepted": first_drive["reports"]}
    assert first_drive["reported"] <= 3 * len(true)
    assert first_drive["link"]["waiting"] == 0
    assert (first_drive["faults"], first_drive["broken_off"], first_drive["dropped"]) == (0, None, 0)


def test_the_next_car_is_warned_before_its_own_lidar_sees_anything(
    bags: Path, server: Served, first_drive: dict[str, Any], tmp_path: Path
) -> None:
    assert first_drive["reports"]
    arguments = (*of(bags, "second"), "--server", server.address, "--as-if-now", "--state", tmp_path)
    said = counted(tmp_path / "counts.json", *arguments)
    assert (said["detections"], said["tracks"], said["reports"]) == (0, 0, 0)
    assert said["warned"] == len(street().obstacles)


def test_bags_are_written_to_a_new_folder_only_and_are_the_same_every_time(bags: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").touch()
    refused = CliRunner().invoke(app, ["simulate", "bags", "--out", str(tmp_path)])
    assert (refused.exit_code, refused.stderr) == (
        1,
        f"headsup simulate bags: {tmp_path}: is not empty; give a new or empty folder\n",
    )
    again = tmp_path / "again"
    assert CliRunner().invoke(app, ["simulate", "bags", "--out", str(again)]).exit_code == 0
    for one, other in zip(
        *(open_source(str(folder / "second"), SourceOptions()) for folder in (bags, again)), strict=True
    ):
        assert (one.stamp_s, one.gnss) == (other.stamp_s, other.gnss)
        assert np.array_equal(one.points_m, other.points_m)


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), 1, "No space left on device; give --out a folder where"),
        (
            sqlite3.OperationalError("database or disk is full"),
            1,
            "database or disk is full; give --out a folder where",
        ),
        (KeyboardInterrupt(), 130, "interrupted; no bags were written"),
    ],
)
def test_bags_that_cannot_be_finished_leave_an_empty_folder_for_the_next_try(
    error: BaseException, code: int, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def half_written(folder: Path, *_: object) -> None:
        if folder.name == "first":
            folder.mkdir()
            return
        raise error

    monkeypatch.setattr("vehicle_client.recording.ros_bag.write_bag", half_written)
    refused = CliRunner().invoke(app, ["simulate", "bags", "--out", str(tmp_path)])
    assert refused.exit_code == code
    assert message in refused.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_bags_transforms_place_the_lidar_where_car_toml_does(bags: Path) -> None:
    calibrated = read_calibration(bags / "car.toml").vehicle.vehicle_from_sensor
    for name in ("first", "second"):
        with Reader(bags / name) as reader:
            wanted = [connection for connection in reader.connections if connection.topic == "/tf_static"]
            ((connection, _, data),) = reader.messages(wanted)
        mounting = get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr(data, connection.msgtype)
        (lidar,) = (placed for placed in mounting.transforms if placed.child_frame_id == "lidar")
        at, turn = lidar.transform.translation, lidar.transform.rotation
        assert [at.x, at.y, at.z] == calibrated[:3, 3].tolist()
        assert [turn.x, turn.y, turn.z, turn.w] == [0.0, 0.0, 0.0, 1.0]
        assert np.array_equal(calibrated[:3, :3], np.eye(3))


def test_a_drive_that_is_told_to_end_ends_in_order_with_its_recording_and_its_counts(
    bags: Path, tmp_path: Path
) -> None:
    recording, counts = tmp_path / "drive.mcap", tmp_path / "counts.json"
    arguments = (*of(bags, "first"), "--realtime", "--record", recording, "--json", counts)
    with subprocess.Popen([*COMMAND, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        begun = tmp_path / "drive.mcap.part"
        deadline_s = time.monotonic() + PATIENCE_S
        while not (begun.exists() and begun.stat().st_size) and time.monotonic() < deadline_s:
            time.sleep(0.05)
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, errors
    said = json.loads(counts.read_text())
    assert 0 < said["frames"] < 111
    assert recording.stat().st_size > 0
    assert not begun.exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nowhere.bag",), "nowhere.bag: no such file, folder or address"),
        (
            ("{bag}", "--record", "/nowhere/at/all/drive.mcap"),
            "/nowhere/at/all/drive.mcap: there is no folder /nowhere",
        ),
        (("{bag}", "--topic", "sweep"), "--topic sweep: expected ROLE=TOPIC"),
        (("{bag}", "--calibration", "nowhere.toml"), "nowhere.toml: cannot be read"),
    ],
)
def test_what_cannot_be_driven_is_one_line_and_exit_code_1(
    bags: Path, arguments: tuple[str, ...], message: str
) -> None:
    done = CliRunner().invoke(app, ["drive", *(argument.format(bag=bags / "second") for argument in arguments)])
    assert done.exit_code == 1
    assert done.stdout == ""
    assert done.stderr.startswith(f"headsup drive: {message}")
    assert done.stderr.count("\n") == 1


@pytest.mark.realdata
@pytest.mark.skipif(not (DATA / "kitti_drive").is_dir(), reason="no recorded data here (HEADSUP_DATA)")
def test_a_real_street_without_potholes_measures_none_and_says_why_nothing_is_reported(tmp_path: Path) -> None:
    street = tmp_path / "street"
    street.mkdir()
    for sweep in sorted((DATA / "kitti_drive").glob("*.laz"))[:SWEEPS]:
        (street / sweep.name).symlink_to(sweep.absolute())
    said = counted(tmp_path / "counts.json", street, "--sensor-height", "1.73", "--state", tmp_path)
    assert said["frames"] == SWEEPS
    assert said["measured"].get("pothole", 0) == 0
    assert (said["reports"], said["placed"]) == (0, 0)
    assert said["reasons"] == {"no satellite fix yet": SWEEPS}
    assert said["tracks"] > 0
