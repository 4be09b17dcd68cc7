from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from headsup.simulate.app import simulate_app

pytest.importorskip("carla")

EXAMPLE = Path(__file__).parents[3] / "docs" / "examples" / "crossroads.xodr"


def run(*arguments: str | Path) -> tuple[int, str]:
    result = CliRunner().invoke(simulate_app, ["drive", *(str(argument) for argument in arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, result.output


def test_a_drive_on_a_map_names_the_map_and_lies_where_it_is_told(tmp_path: Path) -> None:
    out = tmp_path / "run"
    code, output = run(
        "--map", EXAMPLE, "--origin", "52.52,13.405", "--out", out, "--egos", 1, "--seconds", 0.2,
        "--no-images", "--no-mcap", "--no-traffic", "--sensors", "hdl32",
    )  # fmt: skip
    assert code == 0, output
    recording = json.loads((out / "recording.json").read_text())
    assert recording["asked"]["map_file"] == {
        "file": "crossroads.xodr",
        "sha256": hashlib.sha256(EXAMPLE.read_bytes()).hexdigest(),
        "origin": {"latitude_deg": 52.52, "longitude_deg": 13.405},
    }
    assert recording["georeference"]["latitude_deg"] == pytest.approx(52.52, abs=0.005)
    assert recording["egos"][0]["frames"] == 4
    assert json.loads((out / "obstacles.json").read_text())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--map", "absent.xodr"], "cannot be read"),
        (["--origin", "1,2"], "--map"),
        (["--map", EXAMPLE, "--origin", "north"], "LATITUDE,LONGITUDE"),
        (["--map", EXAMPLE, "--origin", "91,0"], "LATITUDE,LONGITUDE"),
        (["--map", EXAMPLE, "--seconds", "300"], "use --seconds"),
    ],
)
def test_what_cannot_be_driven_is_refused_in_words(tmp_path: Path, arguments: list[str | Path], message: str) -> None:
    code, output = run("--out", tmp_path / "run", *arguments)
    assert code == 1
    last = output.splitlines()[-1]
    assert last.startswith("headsup simulate drive: ")
    assert message in last
    assert "Traceback" not in output
    assert not (tmp_path / "run").exists()
