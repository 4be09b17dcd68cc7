from __future__ import annotations

import json
from pathlib import Path

import cv2
import pytest
from typer.testing import CliRunner

from headsup.simulate.app import simulate_app
from headsup.simulate.pothole_command import Kind, Profile, Shape
from simulator.samples.gallery import GALLERY, gallery_name, gallery_sample
from simulator.samples.sample import SampleKind
from simulator.samples.scan import write_mould
from simulator.shapes.debris import DebrisKind
from simulator.shapes.hump import HumpProfile
from simulator.shapes.pothole import PotholeShape


def run(out: Path, *arguments: str | Path) -> tuple[int, str]:
    result = CliRunner().invoke(simulate_app, ["pothole", "--out", str(out), *(str(word) for word in arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, result.stderr


def truth(out: Path, name: str) -> dict[str, dict[str, float]]:
    answer: dict[str, dict[str, float]] = json.loads((out / f"{name}.json").read_text())
    return answer


@pytest.fixture
def mould(tmp_path: Path) -> Path:
    write_mould(tmp_path / "mould.ply", PotholeShape(0.6, 0.45, 0.08).relief(1))
    return tmp_path / "mould.ply"


def test_help_shows_examples() -> None:
    result = CliRunner().invoke(simulate_app, ["pothole", "--help"])
    assert result.exit_code == 0
    assert "headsup simulate pothole --kind mixed --count 24 --sheet" in result.output


def test_the_options_name_everything_the_generator_can_make() -> None:
    assert {kind.value for kind in Kind} == {kind.value for kind in SampleKind} | {"mixed"}
    assert {shape.value for shape in Shape} == {kind.value for kind in DebrisKind}
    assert {profile.value for profile in Profile} == {profile.value for profile in HumpProfile}


def test_each_sample_is_a_mesh_a_textured_mesh_and_its_truth(tmp_path: Path) -> None:
    code, _ = run(tmp_path / "out", "--count", "2", "--seed", "7", "--length", "0.4", "--width", "0.3")
    assert code == 0
    endings = ("json", "mtl", "obj", "ply", "png")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        f"pothole-{seed:04d}.{ending}" for seed in (7, 8) for ending in endings
    ]
    assert truth(tmp_path / "out", "pothole-0008")["size"]["length_m"] == pytest.approx(0.4, abs=0.021)


def test_sizes_walls_lobes_water_and_wear_arrive(tmp_path: Path) -> None:
    words = "--length 0.6 --width 0.5 --depth 0.08 --wall 0.05 --lobes 2 --water 0.5 --grow 44 --patch-side 3"
    code, _ = run(tmp_path, *words.split())
    assert code == 0
    made = truth(tmp_path, "pothole-0001")
    asked = {"length_m": 0.6, "width_m": 0.5, "depth_m": 0.08, "wall_m": 0.05, "lobes": 2, "water": 0.5}
    assert made["parameters"].items() >= (asked | {"grown_percent": 44.0}).items()
    assert made["size"]["length_m"] == pytest.approx(0.72, abs=0.025)
    assert made["size"]["depth_m"] == pytest.approx(0.08 * 1.44)
    assert made["mesh"]["box_m"][1][:2] == [1.5, 1.5]


@pytest.mark.parametrize(
    ("words", "name", "size"),
    [
        ("--kind bump --length 0.9 --width 0.6 --height 0.07", "bump-0001", (0.9, 0.6, 0.07)),
        ("--kind hump --profile flat-top --length 2 --width 1.5 --height 0.05", "hump-0001", (2.0, 1.5, 0.05)),
        ("--kind debris --shape cone --length 0.7 --width 0.3 --height 0.3", "debris-0001", (0.7, 0.3, 0.3)),
    ],
)
def test_what_rises_has_the_sizes_asked_for(
    tmp_path: Path, words: str, name: str, size: tuple[float, float, float]
) -> None:
    code, _ = run(tmp_path, *words.split())
    assert code == 0
    made = truth(tmp_path, name)["size"]
    assert (made["length_m"], made["width_m"]) == pytest.approx(size[:2], abs=0.021)
    assert made["height_m"] == pytest.approx(size[2], rel=0.01)


def test_a_scan_is_set_into_the_road_at_the_length_asked_for_or_at_its_own(tmp_path: Path, mould: Path) -> None:
    assert run(tmp_path / "scaled", "--scan", mould, "--length", "1.2", "--depth", "0.1")[0] == 0
    assert run(tmp_path / "true", "--scan", mould, "--true-size", "--fill", "0.25")[0] == 0
    scaled, true = (truth(tmp_path / name, "pothole-0001")["size"] for name in ("scaled", "true"))
    assert (scaled["length_m"], scaled["depth_m"]) == pytest.approx((1.2, 0.1), abs=0.03)
    assert true["length_m"] == pytest.approx(0.6, abs=0.05)
    assert true["depth_m"] == pytest.approx(0.06, abs=0.007)


def test_the_same_options_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("one", "again"):
        assert run(tmp_path / name, "--count", "2", "--seed", "3", "--length", "0.3", "--width", "0.2")[0] == 0
    files = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert len(files) == 10
    for name in files:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "again" / name).read_bytes()


def test_files_that_exist_are_not_overwritten(tmp_path: Path) -> None:
    words = ("--kind", "debris", "--shape", "rock")
    assert run(tmp_path, *words)[0] == 0
    before = (tmp_path / "debris-0001.ply").read_bytes()
    code, message = run(tmp_path, *words, "--length", "0.5")
    assert code == 1
    assert "debris-0001.* exists: choose another --out or --seed" in message
    assert (tmp_path / "debris-0001.ply").read_bytes() == before
    assert run(tmp_path, *words, "--seed", "2")[0] == 0


def test_a_sheet_shows_the_samples(tmp_path: Path) -> None:
    code, _ = run(tmp_path, "--kind", "debris", "--count", "2", "--sheet")
    assert code == 0
    picture = cv2.imread(str(tmp_path / "sheet.png"))
    assert picture.shape[1] > 2 * 400
    assert picture.std() > 20


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--depth 0.9", "depth_m of a pothole must be between 0.01 and 0.5, not 0.9"),
        ("--length 0.01", "length_m of a pothole must be between"),
        ("--length nan", "length_m of a pothole must be between"),
        ("--lobes 9", "lobes of a pothole must be between 1 and 5"),
        ("--water 1.5", "water of a pothole must be between"),
        ("--fill 2", "filled to between 0 and 1"),
        ("--grow -100", "growth is -50 to 300 %"),
        ("--patch-side 0.2", "has sides of"),
        ("--kind hump --height 0.3", "a road hump is 0.025 to 0.1 m high"),
        ("--kind bump --height -1", "height_m of a bump must be between"),
        ("--kind debris --length 99", "length_m of debris must be between"),
        ("--kind bump --lobes 2", "--lobes is not for --kind bump (it is for: pothole)"),
        ("--kind debris --depth 0.1", "--depth is not for --kind debris (it is for: pothole)"),
        ("--shape tyre", "--shape is not for --kind pothole (it is for: debris)"),
        ("--kind mixed --length 1", "--length is not for --kind mixed (it is for: pothole, bump, hump, debris)"),
        ("--kind debris --patch-side 3", "--patch-side is not for --kind debris (it is for: pothole, bump, hump)"),
        ("--repaired --fill 0.5", "--fill would change nothing: a repair is level with the road"),
        ("--true-size", "--true-size needs --scan FILE"),
        ("--scan nowhere.ply", "nowhere.ply: cannot be read"),
        ("--scan nowhere.ply --lobes 2", "--lobes cannot be chosen here: the scan has its own"),
        ("--scan nowhere.ply --true-size --length 2", "--length cannot be chosen here: the scan has its own"),
        ("--scan nowhere.ply --count 2", "--scan makes one sample"),
    ],
)
def test_what_cannot_be_is_one_clear_line_and_leaves_nothing(tmp_path: Path, words: str, message: str) -> None:
    code, said = run(tmp_path / "out", *words.split())
    assert code == 1
    assert message in said
    assert said.strip().count("\n") == 0
    assert said.strip().startswith("headsup simulate pothole: ")
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_made_is_a_clear_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    code, message = run(tmp_path / "file", "--kind", "debris")
    assert code == 1
    assert "file" in message


def test_the_gallery_holds_twenty_four_sorts_with_names_of_their_own() -> None:
    assert len(GALLERY) == 24
    names = [gallery_name(index, 1) for index in range(48)]
    assert len(set(names)) == 48
    assert gallery_sample(0, 1).name == names[0]
    assert not {character for name in names for character in name} & set(" %/")
