from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from evaluation import composed_scan, table1
from evaluation.table1 import Rates, averages, rates_of, scans_in, score_scans
from headsup.evaluate.app import evaluate_app
from tests.unit.evaluation.dome_files import write_dome


def run(*arguments: str | Path) -> tuple[int, str, str]:
    result = CliRunner().invoke(evaluate_app, ["table1", *(str(argument) for argument in arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, result.stdout, result.stderr


@pytest.fixture
def two_scenes(monkeypatch: pytest.MonkeyPatch) -> None:
    """A twentieth of the table: 100 % and 5 % without noise."""
    for module in (composed_scan, table1):
        monkeypatch.setattr(module, "DENSITIES_PERCENT", (100, 5))
        monkeypatch.setattr(module, "NOISES_MM", (0.0,))


def test_rates_are_shares_of_each_class() -> None:
    truth, called = np.array([1, 1, 1, 1, 0, 0], bool), np.array([1, 1, 1, 0, 1, 0], bool)
    assert rates_of(truth, called) == Rates(75.0, 25.0, 50.0, 50.0)


def test_scans_are_found_in_the_folder_or_its_potholes(tmp_path: Path) -> None:
    for name in ("b", "a"):
        write_dome(tmp_path / f"potholes/{name}.ply", count=500)
    assert [path.stem for path in scans_in(tmp_path)] == ["a", "b"]
    write_dome(tmp_path / "own.ply", count=500)
    assert [path.stem for path in scans_in(tmp_path)] == ["own"]


def test_the_surface_method_tells_a_dome_from_its_road_at_half_a_millimetre_of_noise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table1, "DENSITIES_PERCENT", (100,))
    monkeypatch.setattr(table1, "NOISES_MM", (0.5,))
    write_dome(tmp_path / "dome.ply")
    scored = list(score_scans([tmp_path / "dome.ply"], 1, ("surface",)))
    flat = scored[0].rows()[0].rates
    assert flat.RP > 99.9
    assert flat.RR > 99.9


def test_averages_are_means_over_scans() -> None:
    row = table1.Row("flat road", "a", "surface", 100, 0.0, Rates(100.0, 0.0, 0.0, 100.0))
    other = table1.Row("flat road", "b", "surface", 100, 0.0, Rates(50.0, 50.0, 10.0, 90.0))
    (mean,) = averages([row, other])
    assert (mean.scan, mean.rates) == ("average", Rates(75.0, 25.0, 5.0, 95.0))


@pytest.mark.usefixtures("two_scenes")
def test_the_command_prints_the_papers_figures_beside_ours_and_writes_labels(tmp_path: Path) -> None:
    write_dome(tmp_path / "scans/dome.ply")
    code, printed, _ = run(
        *("--data", tmp_path / "scans", "--json", tmp_path / "t.json", "--save-labels", tmp_path / "labels"),
        "--no-peers",
    )
    assert code == 0
    assert "99.98 / 99.51" in printed
    assert "paper (13 scans)" in printed
    rows = json.loads((tmp_path / "t.json").read_text())["rows"]
    assert {row["scan"] for row in rows} == {"dome", "average"}
    surface = [r for r in rows if r["method"] == "surface" and r["road"] == "flat road" and r["scan"] == "average"]
    assert all(row["RP"] == 100.0 and row["RR"] > 99.9 for row in surface)
    assert all(row["RP"] + row["NR"] == pytest.approx(100.0) for row in rows)
    names = sorted(path.name for path in (tmp_path / "labels").iterdir())
    assert names == ["dome_d100_n0.00.npz", "dome_d5_n0.00.npz"]
    saved = np.load(tmp_path / "labels/dome_d5_n0.00.npz")
    assert {key: saved[key].dtype for key in ("truth", "saliency", "surface")} == dict.fromkeys(
        ("truth", "saliency", "surface"), np.dtype(np.uint8)
    )
    assert saved["points"].shape == (len(saved["truth"]), 3)
    assert np.ptp(saved["points"][:, 0]) > 500.0


def test_a_folder_without_scans_is_an_error_of_one_line(tmp_path: Path) -> None:
    code, _, error = run("--data", tmp_path)
    assert code == 1
    assert "no *.ply" in error
    assert len(error.strip().splitlines()) == 1


def test_a_broken_scan_is_named(tmp_path: Path) -> None:
    (tmp_path / "broken.ply").write_text("no cloud")
    code, _, error = run("--data", tmp_path)
    assert code == 1
    assert "broken.ply" in error
