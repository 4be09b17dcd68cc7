"""Samples as files: a mesh with labels, the same with a texture, and the truth as JSON."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from simulator.samples.labelled_mesh import LabelledMesh, debris_mesh
from simulator.samples.mesh_files import write_obj, write_ply
from simulator.samples.patch_mesh import patch_half_size, patch_mesh
from simulator.samples.patch_texture import patch_texture
from simulator.samples.sample import Sample
from simulator.shapes.debris import Debris
from simulator.shapes.footprint import footprint_polygon
from simulator.shapes.relief import Material, Relief

CONVENTIONS = {
    "frame": "x along the length, y to its left, z up; origin in the middle, z = 0 is the sound road",
    "units": "metres, square metres, cubic metres",
    "length_m, width_m": "extents of the footprint along x and y",
    "depth_m": "greatest depth below the sound road, to the ground under standing water",
    "height_m": "greatest height above the sound road",
    "volume_m3": "between the sound road and the ground inside the footprint; of debris, of the convex hull",
    "footprint_m": "corners x, y, counter-clockwise, not closed; of debris, of the plan's convex hull",
    "label": "PLY, a vertex: 1 inside the footprint of an obstacle, else 0; a repair and a hole filled up are none",
    "material": "PLY, a vertex: " + ", ".join(f"{m.value} {m.name.lower()}" for m in Material),
}


def write_sample(sample: Sample, folder: Path, side_m: float | None = None) -> None:
    """Write NAME.ply, .obj, .mtl, .json, and for what is worn into a road patch .png; the same bytes each time.

    A relief comes with a square road patch of `side_m` around it, by default as large as it needs.
    """
    mesh = sample_mesh(sample, side_m)
    folder.mkdir(parents=True, exist_ok=True)
    write_ply(folder / f"{sample.name}.ply", mesh)
    if isinstance(sample.shape, Debris):
        write_obj(folder / f"{sample.name}.obj", mesh, sample.shape.colour)
    else:
        texture = patch_texture(sample.shape, patch_half_size(sample.shape, side_m), sample.seed)
        write_obj(folder / f"{sample.name}.obj", mesh, texture)
    text = json.dumps(describe(sample, mesh), indent=1) + "\n"
    (folder / f"{sample.name}.json").write_text(text, encoding="utf-8")


def sample_mesh(sample: Sample, side_m: float | None = None) -> LabelledMesh:
    """Closed mesh of a thing, or of the road patch around a relief; only an obstacle's footprint is labelled."""
    if isinstance(sample.shape, Debris):
        return debris_mesh(sample.shape)
    mesh = patch_mesh(sample.shape, side_m)
    return mesh if sample.hazard else replace(mesh, label=np.zeros_like(mesh.label))


def describe(sample: Sample, mesh: LabelledMesh) -> dict[str, object]:
    """The truth of a sample, as its JSON file states it."""
    shape = sample.shape
    is_hole = isinstance(shape, Relief) and shape.is_hole
    size: dict[str, float] = {
        "length_m": shape.length_m,
        "width_m": shape.width_m,
        "depth_m" if is_hole else "height_m": shape.relief_m,
        "area_m2": shape.footprint_area_m2,
        "volume_m3": shape.volume_m3,
    }
    if isinstance(shape, Relief):
        size |= _water(shape)
    low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
    return {
        "name": sample.name,
        "kind": str(sample.kind),
        "hazard": sample.hazard,
        "seed": sample.seed,
        "parameters": sample.parameters,
        "size": {name: round(value, 8) for name, value in size.items()},
        "footprint_m": np.round(footprint_polygon(shape), 4).tolist(),
        "mesh": {
            "vertices": len(mesh.vertices_m),
            "triangles": len(mesh.triangles),
            "box_m": [np.round(low, 4).tolist(), np.round(high, 4).tolist()],
        },
        "conventions": CONVENTIONS,
    }


def _water(relief: Relief) -> dict[str, float]:
    """How far below the road standing water begins, and over which area; nothing of a dry one."""
    if relief.materials is None or relief.floor_m is None:
        return {}
    wet = relief.materials == Material.WATER
    if not wet.any():
        return {}
    return {
        "water_below_road_m": -float(relief.heights_m[wet].max()),
        "water_area_m2": float(np.count_nonzero(wet)) * relief.step_m**2,
    }
