from __future__ import annotations

import inspect
import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from headsup.simulate.app import simulate_app
from headsup.simulate.dataset_command import dataset
from headsup.simulate.drive_command import drive
from headsup.simulate.drive_options import DriveOptions

SENSORS = {
    "sensors": [
        {
            "type": "sensor.lidar.ray_cast",
            "role_name": "lidar",
            "channels": 8,
            "range": 40.0,
            "rotation_frequency": 10.0,
        }
    ]
}


def run(*arguments: str | Path | float) -> tuple[int, str]:
    result = CliRunner().invoke(simulate_app, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, result.output


@pytest.fixture
def sensors(tmp_path: Path) -> Path:
    path = tmp_path / "sensors.json"
    path.write_text(json.dumps(SENSORS))
    return path


def test_a_drive_says_what_it_was_made_from_and_has_an_overview(tmp_path: Path, sensors: Path) -> None:
    out = tmp_path / "run"
    code, output = run(
        *("drive", "--out", out, "--egos", 1, "--seconds", 0.2, "--seed", 9, "--sensors", sensors),
        *("--no-mcap", "--no-traffic", "--roughness", "C"),
    )
    assert code == 0, output
    assert "1 vehicle, " in output
    recording = json.loads((out / "recording.json").read_text())
    assert recording["seed"] == 9
    assert recording["sensors"] == SENSORS["sensors"]
    assert recording["asked"].items() >= {"egos": 1, "seconds": 0.2, "traffic": False, "mcap": False}.items()
    assert recording["asked"]["world"]["roughness"] == "C"
    assert recording["egos"] == [{"folder": "ego0", "frames": 2, "first": 0, "last": 1}]
    assert (out / "overview.png").read_bytes().startswith(b"\x89PNG")
    assert not list(out.rglob("*.mcap"))


def test_a_folder_that_holds_something_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "photo.jpg").write_text("mine")
    code, output = run("drive", "--out", tmp_path, "--seconds", 0.1)
    assert code == 1
    assert output.splitlines()[-1].startswith("headsup simulate drive:")
    assert output.splitlines()[-1].endswith("give a new or an empty folder")
    assert [path.name for path in tmp_path.iterdir()] == ["photo.jpg"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--sensors", "hdl128"], "no built-in rig (paper, hdl64, hdl32)"),
        (["--data", "/nowhere"], "/nowhere"),
    ],
)
def test_what_cannot_be_used_is_one_line_of_either_command(tmp_path: Path, arguments: list[str], message: str) -> None:
    for command in ("drive", "dataset"):
        code, output = run(command, "--out", tmp_path / "run", *arguments)
        assert code == 1
        assert message in output
        assert output.strip().count("\n") == 0
        assert not list(tmp_path.glob("run/*"))


def test_a_mistake_in_a_sensors_file_is_named_with_sensor_and_field(tmp_path: Path, sensors: Path) -> None:
    sensors.write_text(sensors.read_text().replace("channels", "chanels"))
    code, output = run("drive", "--out", tmp_path / "run", "--sensors", sensors)
    assert code == 1
    assert "sensor 1 (sensor.lidar.ray_cast, lidar): chanels" in output


@pytest.mark.parametrize("wrong", [("--seconds", "nan"), ("--seconds", "0"), ("--egos", "9"), ("--seed", "-1")])
def test_numbers_out_of_range_are_refused(tmp_path: Path, wrong: tuple[str, str]) -> None:
    code, output = run("drive", "--out", tmp_path / "run", *wrong)
    assert code == 2
    assert wrong[0] in output
    assert not (tmp_path / "run").exists()


def test_both_commands_take_every_option_of_a_drive() -> None:
    of_drive, of_dataset = (inspect.signature(command).parameters for command in (drive, dataset))
    shared = {name: of_drive[name] for name in of_drive.keys() - {"out", "seed"}}
    assert set(shared) == set(inspect.signature(DriveOptions).parameters)
    for name, option in shared.items():
        assert of_dataset[name].default == option.default
        assert vars(of_dataset[name].annotation.__metadata__[0]) == vars(option.annotation.__metadata__[0])
    assert set(of_dataset) - set(shared) == {"out", "drives", "first_seed"}


def test_one_seed_differs_from_the_next_in_nothing_but_the_seed() -> None:
    plan = DriveOptions(images=False).planner()
    one, other = plan(1), plan(2)
    assert (one.scenario.seed, other.scenario.seed) == (1, 2)
    assert one.asked == other.asked
    assert one.sensors == other.sensors
    assert not [entry for entry in one.sensors if "camera" in str(entry["type"])]
