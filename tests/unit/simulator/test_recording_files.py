from __future__ import annotations

import io
from pathlib import Path

import carla
import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from simulator.recording.files import GrowingFiles, RecordingError, csv_line, json_bytes, npz_bytes, png_bytes
from simulator.recording.ply_text import LIDAR_PROPERTIES, SEMANTIC_PROPERTIES, ply_text
from simulator.recording.semantic_tags import TAG_OF_SURFACE, SemanticTag, object_indices, semantic_tags
from simulator.scene.scenery import Surface

coordinates = st.floats(-1e6, 1e6, width=32)


def body_of(file: bytes) -> str:
    return file.decode("ascii").partition("end_header\n")[2]


@settings(deadline=None)  # the first example compiles
@given(arrays.arrays(np.float32, st.tuples(st.integers(0, 40), st.just(4)), elements=coordinates))
def test_numbers_are_rounded_as_printf_does(values: np.ndarray) -> None:
    lines = "".join(" ".join(f"{v:.4f}" for v in row) + "\n" for row in values.astype(np.float64).tolist())
    assert body_of(ply_text(LIDAR_PROPERTIES, values)) == lines


@settings(deadline=None)
@given(
    arrays.arrays(np.uint32, st.tuples(st.integers(0, 40), st.just(2))),
)
def test_whole_numbers_follow_without_a_point(whole: np.ndarray) -> None:
    lines = "".join(f"0.0000 0.0000 0.0000 0.0000 {a} {b}\n" for a, b in whole.tolist())
    assert body_of(ply_text(SEMANTIC_PROPERTIES, np.zeros((len(whole), 4), np.float32), whole)) == lines


def test_a_large_sweep_is_the_same_as_its_lines_one_by_one() -> None:
    values = np.random.default_rng(1).normal(0, 30, (20_001, 4)).astype(np.float32)
    lines = "".join(" ".join(f"{v:.4f}" for v in row) + "\n" for row in values.astype(np.float64).tolist())
    assert body_of(ply_text(LIDAR_PROPERTIES, values)) == lines


def test_the_header_is_carlas() -> None:
    file = ply_text(SEMANTIC_PROPERTIES, np.zeros((1, 4), np.float32), np.array([[7, 1]], np.uint32))
    assert file.decode() == (
        "ply\nformat ascii 1.0\nelement vertex 1\n"
        "property float32 x\nproperty float32 y\nproperty float32 z\n"
        "property float32 CosAngle\nproperty uint32 ObjIdx\nproperty uint32 ObjTag\nend_header\n"
        "0.0000 0.0000 0.0000 0.0000 7 1\n"
    )


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 3e38])
def test_a_point_that_is_no_place_is_refused(bad: float) -> None:
    values = np.zeros((5, 4), np.float32)
    values[3, 1] = bad
    with pytest.raises(ValueError, match="not finite"):
        ply_text(LIDAR_PROPERTIES, values)


def test_properties_must_fit_the_numbers() -> None:
    with pytest.raises(ValueError, match="do not fit"):
        ply_text(LIDAR_PROPERTIES, np.zeros((5, 3), np.float32))


def test_an_archive_reads_back_and_has_the_same_bytes_each_time() -> None:
    arrays_in = {"a": np.arange(9, dtype=np.int32), "b": np.random.default_rng(0).random((3, 2)).astype(np.float32)}
    first, second = npz_bytes(arrays_in), npz_bytes(arrays_in)
    assert first == second
    with np.load(io.BytesIO(first), allow_pickle=False) as read:
        assert sorted(read.files) == ["a", "b"]
        for name, array in arrays_in.items():
            assert read[name].dtype == array.dtype
            assert read[name].tolist() == array.tolist()


def test_a_picture_reads_back() -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (8, 12, 3), dtype=np.uint8)
    read = cv2.imdecode(np.frombuffer(png_bytes(pixels), np.uint8), cv2.IMREAD_UNCHANGED)
    assert read.tolist() == pixels.tolist()


def test_tags_stand_in_the_red_channel() -> None:
    tags = np.array([[0, 1, 24], [14, 12, 9]], dtype=np.uint8)
    blue, green, red = np.moveaxis(cv2.imdecode(np.frombuffer(png_bytes(tags), np.uint8), cv2.IMREAD_UNCHANGED), 2, 0)
    assert red.tolist() == tags.tolist()
    assert not blue.any()
    assert not green.any()


def test_an_empty_picture_is_refused() -> None:
    with pytest.raises((RecordingError, cv2.error)):
        png_bytes(np.zeros((0, 5, 3), np.uint8))


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=5))
def test_numbers_in_tables_read_back_exactly(values: list[float]) -> None:
    assert [float(word) for word in csv_line(values).split(",")] == values


def test_json_refuses_what_it_does_not_know() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        json_bytes({"a": float("nan")})


def test_a_growing_file_has_its_separators_between_and_its_columns_once(tmp_path: Path) -> None:
    texts = GrowingFiles()
    for value in ("1", "2", "3"):
        texts.add(tmp_path / "list.txt", value, between=", ")
        texts.add(tmp_path / "deep" / "table.csv", value + "\n", before_first="v\n")
    texts.close()
    assert (tmp_path / "list.txt").read_text() == "1, 2, 3"
    assert (tmp_path / "deep" / "table.csv").read_text() == "v\n1\n2\n3\n"


def test_every_surface_has_a_tag_of_carla() -> None:
    assert set(TAG_OF_SURFACE) == set(Surface)
    theirs = {name.upper(): int(value) for name, value in carla.CityObjectLabel.names.items()}
    names = {tag.name.replace("_", ""): int(tag) for tag in SemanticTag}
    assert names == {name: theirs[name] for name in names}


def test_tags_follow_the_table() -> None:
    surface = np.array([Surface.ROAD, Surface.CAR, Surface.NOTHING, Surface.PAVEMENT], dtype=np.uint8)
    assert semantic_tags(surface).tolist() == [1, 14, 11, 2]
    assert semantic_tags(surface.reshape(2, 2)).shape == (2, 2)
    with pytest.raises(ValueError, match="120"):
        semantic_tags(np.array([120], dtype=np.uint8))


def test_what_a_carla_server_calls_a_surface_stays_as_it_is() -> None:
    assert semantic_tags(np.array([128 + 15, 128 + 28], dtype=np.uint8)).tolist() == [15, 28]


def test_the_object_of_a_point_is_the_moving_thing_before_the_obstacle() -> None:
    obstacle, mover = np.array([0, 2, 0, 2], np.int32), np.array([0, 0, 5, 5], np.int32)
    assert object_indices(obstacle, mover).tolist() == [0, 1_000_002, 5, 5]
