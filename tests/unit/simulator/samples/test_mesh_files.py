from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import open3d as o3d
import pytest

from simulator.samples.mesh_files import write_ply
from simulator.samples.patch_mesh import patch_mesh
from simulator.samples.sample import Sample, SampleKind, Wishes, make_sample
from simulator.samples.sample_files import sample_mesh, write_sample
from simulator.shapes.debris import DebrisKind
from simulator.shapes.footprint import footprint_polygon
from simulator.shapes.hump import HumpProfile
from simulator.shapes.pothole import PotholeShape
from simulator.shapes.relief import Material

HOLE = make_sample(SampleKind.POTHOLE, 3, Wishes(0.6, 0.5, 0.07, water=0.5))
TYRE = make_sample(SampleKind.DEBRIS, 3, Wishes(shape=DebrisKind.TYRE))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("samples") / "new"
    write_sample(HOLE, path, 2.5)
    write_sample(TYRE, path)
    return path


@pytest.mark.parametrize("sample", [HOLE, TYRE], ids=["pothole", "debris"])
def test_a_mesh_reads_back_as_it_was_from_ply_and_obj(folder: Path, sample: Sample) -> None:
    mesh = sample_mesh(sample, 2.5)
    ply = o3d.io.read_triangle_mesh(str(folder / f"{sample.name}.ply"))
    assert np.asarray(ply.vertices) == pytest.approx(mesh.vertices_m, abs=1e-6)
    assert np.array_equal(np.asarray(ply.triangles), mesh.triangles)
    obj = o3d.io.read_triangle_mesh(str(folder / f"{sample.name}.obj"), True)
    assert np.asarray(obj.vertices)[np.asarray(obj.triangles)] == pytest.approx(
        mesh.vertices_m[mesh.triangles], abs=1e-5
    )
    assert ply.is_edge_manifold(allow_boundary_edges=False)


def test_the_texture_is_found_and_every_corner_has_its_place_on_it(folder: Path) -> None:
    mesh = o3d.io.read_triangle_mesh(str(folder / f"{HOLE.name}.obj"), True)
    texture = cv2.imread(str(folder / f"{HOLE.name}.png"))
    assert np.asarray(mesh.textures[0]).shape == texture.shape
    assert len(mesh.triangle_uvs) == 3 * len(mesh.triangles)


def test_open3d_calls_a_patch_watertight(tmp_path: Path) -> None:
    write_ply(tmp_path / "patch.ply", patch_mesh(PotholeShape(0.5, 0.4, 0.06).relief(1), max_vertices=1_500))
    mesh = o3d.io.read_triangle_mesh(str(tmp_path / "patch.ply"))
    assert mesh.is_watertight()
    assert mesh.get_volume() > 0


def test_labels_and_materials_stand_in_the_ply(folder: Path) -> None:
    mesh = sample_mesh(HOLE, 2.5)
    cloud = o3d.t.io.read_point_cloud(str(folder / f"{HOLE.name}.ply"))
    assert np.array_equal(cloud.point["label"].numpy().ravel(), mesh.label)
    assert np.array_equal(cloud.point["material"].numpy().ravel(), mesh.material)
    assert set(mesh.material) == {Material.ASPHALT, Material.BROKEN, Material.WATER}


def test_the_truth_is_that_of_the_shape(folder: Path) -> None:
    truth = json.loads((folder / f"{HOLE.name}.json").read_text())
    size = truth["size"]
    assert (truth["kind"], truth["hazard"], truth["seed"]) == ("pothole", True, 3)
    assert size["depth_m"] == pytest.approx(0.07)
    assert size["water_below_road_m"] == pytest.approx(0.035)
    assert 0 < size["water_area_m2"] < size["area_m2"]
    assert size["volume_m3"] == pytest.approx(HOLE.shape.volume_m3, abs=1e-6)
    assert truth["parameters"]["length_m"] == 0.6
    corners = np.array(truth["footprint_m"])
    assert np.ptp(corners, axis=0) == pytest.approx([size["length_m"], size["width_m"]], abs=2e-4)
    assert truth["mesh"]["box_m"][1][:2] == [1.25, 1.25]


@pytest.mark.parametrize("seed", range(6))
def test_the_footprint_polygon_has_the_footprints_area_and_runs_counter_clockwise(seed: int) -> None:
    hole = PotholeShape.random(seed).relief(seed)
    x, y = footprint_polygon(hole).T
    area = float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)
    assert area == pytest.approx(hole.footprint_area_m2, rel=0.04)


@pytest.mark.parametrize(
    ("wishes", "material"), [(Wishes(0.6, 0.5, repaired=True), Material.PATCH), (Wishes(fill=1.0), Material.GRAVEL)]
)
def test_a_repair_and_a_hole_filled_up_are_no_obstacles(wishes: Wishes, material: Material) -> None:
    sample = make_sample(SampleKind.POTHOLE, 3, wishes)
    assert not sample.hazard
    assert sample.shape.relief_m < 0.011
    assert not sample_mesh(sample).label.any()
    assert (sample_mesh(sample).material == material).any()


@pytest.mark.parametrize(
    ("kind", "wishes"),
    [
        (SampleKind.POTHOLE, Wishes(grow_percent=20.0, fill=0.5)),
        (SampleKind.BUMP, Wishes(grow_percent=20.0)),
        (SampleKind.HUMP, Wishes(length_m=1.5, width_m=1.2, profile=HumpProfile.FLAT_TOP)),
        (SampleKind.DEBRIS, Wishes()),
    ],
)
def test_the_same_sample_gives_the_same_bytes(tmp_path: Path, kind: SampleKind, wishes: Wishes) -> None:
    for name in ("one", "again"):
        write_sample(make_sample(kind, 5, wishes), tmp_path / name)
    files = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert len(files) == (4 if kind is SampleKind.DEBRIS else 5)
    for name in files:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "again" / name).read_bytes()


def test_growing_and_filling_are_written_down_and_done() -> None:
    plain = make_sample(SampleKind.POTHOLE, 4, Wishes(0.8, 0.6, 0.10, water=0.0))
    worn = make_sample(SampleKind.POTHOLE, 4, Wishes(0.8, 0.6, 0.10, water=0.0, grow_percent=50.0, fill=0.5))
    assert worn.parameters["grown_percent"] == 50.0
    assert worn.parameters["filled"] == 0.5
    assert worn.shape.footprint_area_m2 == pytest.approx(1.5 * plain.shape.footprint_area_m2)
    assert worn.shape.relief_m == pytest.approx(0.075, abs=0.007)
