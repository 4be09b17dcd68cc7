from __future__ import annotations

import json
import shutil
from collections import Counter, namedtuple
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from headsup.simulate.app import simulate_app
from headsup.simulate.drive_options import DriveOptions
from simulator.dataset import BLOCK, DatasetError, PlannedDrive, alone, check_room, planned, split_of, write_dataset
from simulator.fingerprint import plain
from simulator.record import RecordingPlan
from simulator.recording.header import RecordingHeader
from simulator.recording.writer import RecordingWriter
from simulator.shapes.pothole import pothole
from tests.unit.headsup.test_drive_command import SENSORS
from tests.unit.simulator.recording_frames import CAMERA, LIDAR, ego_frame, header, obstacle, sensor_json

FRAMES = 3


def run(*arguments: str | Path | float) -> tuple[int, str]:
    result = CliRunner().invoke(simulate_app, ["dataset", *(str(argument) for argument in arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, result.output


def plans(count: int, first_seed: int = 1, **options: Any) -> list[RecordingPlan]:
    plan = DriveOptions(**{"egos": 2, "images": False, **options}).planner()
    return [plan(seed) for seed in range(first_seed, first_seed + count)]


def make(drive: PlannedDrive, whole: bool = True) -> None:
    """Files as the recorder leaves them, of frames that are quickly made."""
    stated = header((LIDAR, CAMERA))
    plan = drive.plan
    said = RecordingHeader(
        "tests", plan.scenario.seed, stated.start, stated.tick_s, stated.georeference, stated.enu_from_street,
        [sensor_json(LIDAR), sensor_json(CAMERA)], plan.asked,
    )  # fmt: skip
    rows = [obstacle(1), obstacle(1, "grown", 0.2), obstacle(2)]
    with RecordingWriter(drive.folder, said, 2, rows, mcap=False) as recording:
        for index in range(FRAMES):
            for ego in range(2):
                recording.write(ego, ego_frame(index, ego, (LIDAR, CAMERA)))
    path = drive.folder / "recording.json"
    if whole:
        path.write_text(json.dumps(json.loads(path.read_text()) | {"sensors": list(plan.sensors)}))
    else:
        path.unlink()


@given(st.integers(0, 10_000), st.integers(1, 60))
def test_every_twenty_drives_are_split_alike_and_more_drives_change_nothing(first_seed: int, drives: int) -> None:
    parts = [split_of(first_seed, number) for number in range(1, drives + 1)]
    for start in range(0, drives - len(BLOCK) + 1, len(BLOCK)):
        assert Counter(parts[start : start + len(BLOCK)]) == Counter(train=14, val=3, test=3)
    assert parts == [split_of(first_seed, number) for number in range(1, 61)][:drives]


def test_splits_of_different_seeds_differ() -> None:
    assert len({tuple(split_of(seed, number) for number in range(1, 21)) for seed in range(20)}) > 15


def test_a_recording_of_the_same_options_is_there_and_an_unfinished_one_is_not(tmp_path: Path) -> None:
    first, second, third = planned(tmp_path, plans(3))
    make(first)
    make(second, whole=False)
    assert [drive.is_there for drive in (first, second, third)] == [True, False, False]
    assert [drive.folder.name for drive in (first, second, third)] == ["0001", "0002", "0003"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"seconds": 5.0}, "seconds 20.0, not 5.0"),
        ({"mcap": False}, "mcap true, not false"),
        ({"egos": 3}, "egos 2, not 3"),
        ({"sensors": "hdl32"}, "other sensors"),
        ({"images": True}, "other sensors"),
        ({"first_seed": 7}, "seed 1, not 7"),
        ({"traffic": False, "changes": False}, "traffic true, not false; changes true, not false"),
    ],
)
def test_a_recording_of_other_options_is_an_error_that_says_which(
    tmp_path: Path, options: dict[str, Any], said: str
) -> None:
    make(planned(tmp_path, plans(1))[0])
    (other,) = planned(tmp_path, plans(1, **options))
    with pytest.raises(DatasetError, match="was made with other options") as raised:
        _ = other.is_there
    assert said in str(raised.value)


def test_a_recording_that_is_not_json_is_an_error(tmp_path: Path) -> None:
    (drive,) = planned(tmp_path, plans(1))
    drive.folder.mkdir()
    (drive.folder / "recording.json").write_text("{")
    with pytest.raises(DatasetError, match="not JSON"):
        _ = drive.is_there


def test_only_what_a_recorder_left_is_removed(tmp_path: Path) -> None:
    ours, foreign, file = planned(tmp_path, plans(3))
    make(ours, whole=False)
    (ours.folder / "ego0.mcap.part").write_bytes(b"half")
    make(foreign, whole=False)
    (foreign.folder / "notes.txt").write_text("mine")
    file.folder.write_text("a file")
    ours.clear()
    assert not ours.folder.exists()
    for drive in (foreign, file):
        with pytest.raises(DatasetError, match="no unfinished recording"):
            drive.clear()
    assert (foreign.folder / "notes.txt").read_text() == "mine"


def test_a_data_set_is_described_by_what_is_in_its_files(tmp_path: Path) -> None:
    drives = planned(tmp_path, plans(4, first_seed=11))
    for drive in drives:
        make(drive)
    write_dataset(tmp_path, drives)
    first = (tmp_path / "dataset.json").read_bytes()
    said = json.loads(first)
    assert [(one["folder"], one["seed"]) for one in said["drives"]] == [(f"000{n}", 10 + n) for n in (1, 2, 3, 4)]
    assert sorted(name for part in said["split"].values() for name in part) == ["0001", "0002", "0003", "0004"]
    assert all(one["folder"] in said["split"][one["split"]] for one in said["drives"])
    one = said["drives"][0]
    assert one["frames"] == [FRAMES, FRAMES]
    assert (one["sweeps"], one["pictures"], one["points"]) == (6, 6, 6 * 400)
    assert (one["obstacles"], one["changes"]) == ({"pothole": 2}, {"grown": 1})
    assert one["bytes"] == sum(path.stat().st_size for path in drives[0].folder.rglob("*") if path.is_file())
    assert said["totals"]["obstacles"] == {"pothole": 8}
    assert said["totals"]["frames"] == 4 * 2 * FRAMES
    write_dataset(tmp_path, planned(tmp_path, plans(4, first_seed=11)))
    assert (tmp_path / "dataset.json").read_bytes() == first


def test_a_disk_without_room_for_the_missing_drives_is_told_before_they_are_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drives = planned(tmp_path, plans(3))
    make(drives[0])
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(10**12, 0, 3 * drives[0].size_bytes))
    check_room(tmp_path, drives[:1], 2)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(10**12, 0, drives[0].size_bytes))
    with pytest.raises(DatasetError, match="2 drives that are missing need about"):
        check_room(tmp_path, drives[:1], 2)
    check_room(tmp_path, [], 2)


def test_two_commands_do_not_make_drives_in_one_folder(tmp_path: Path) -> None:
    with alone(tmp_path / "set"):
        code, output = run("--out", tmp_path / "set", "--drives", 1)
        assert code == 1
        assert "another command makes drives there" in output
    with alone(tmp_path / "set"):
        pass


def test_plans_with_other_scans_are_told_apart() -> None:
    one, same, other = (
        plain(pothole(1, 0.6, 0.5, 0.08)),
        plain(pothole(1, 0.6, 0.5, 0.08)),
        plain(pothole(2, 0.6, 0.5, 0.08)),
    )
    assert json.dumps(one) == json.dumps(same)
    assert one != other


def test_a_drive_that_fails_is_named_and_the_others_go_on_until_all_are_there(tmp_path: Path) -> None:
    out, sensors = tmp_path / "set", tmp_path / "sensors.json"
    sensors.write_text(json.dumps(SENSORS))
    asked = (
        *("--out", out, "--drives", 2, "--first-seed", 21, "--egos", 1, "--seconds", 0.1, "--sensors", sensors),
        *("--no-mcap", "--no-traffic"),
    )
    out.mkdir()
    (out / "0001").symlink_to(tmp_path / "nowhere" / "0001")
    code, output = run(*asked)
    assert code == 1
    assert f"seed 21 ({out}/0001)" in output
    assert "1 of 2 drives failed" in output
    assert (out / "0002/recording.json").exists()
    assert not (out / "dataset.json").exists()

    (out / "0001").unlink()
    made = (out / "0002/recording.json").stat().st_mtime_ns
    code, output = run(*asked)
    assert code == 0, output
    assert "2 drives" in output
    assert (out / "0002/recording.json").stat().st_mtime_ns == made
    described = json.loads((out / "dataset.json").read_text())
    assert [drive["seed"] for drive in described["drives"]] == [21, 22]

    for path in (out / "0001").rglob("*"):
        if path.is_file() and path.suffix in {".ply", ".npz", ".csv", ".json"}:
            assert path.read_bytes() != (out / "0002" / path.relative_to(out / "0001")).read_bytes()
