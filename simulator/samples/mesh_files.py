"""Meshes as files that other programs read: binary PLY with labels, and OBJ with its material and texture."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from simulator.samples.labelled_mesh import LabelledMesh
from simulator.shapes.relief import Material

Colour = tuple[float, float, float]

VERTEX = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("label", "u1"), ("material", "u1")])
TEXTURED_VERTEX = np.dtype([*VERTEX.descr[:3], ("s", "<f4"), ("t", "<f4"), *VERTEX.descr[3:]])
FACE = np.dtype([("count", "u1"), ("corners", "<i4", (3,))])
PLY_TYPES = {"f4": "float", "u1": "uchar"}


def write_ply(path: Path, mesh: LabelledMesh) -> None:
    """Binary little-endian PLY in metres: x, y, z (and texture coordinates s, t), label and material a vertex."""
    vertices = np.empty(len(mesh.vertices_m), VERTEX if mesh.uv is None else TEXTURED_VERTEX)
    for axis, name in enumerate("xyz"):
        vertices[name] = mesh.vertices_m[:, axis]
    if mesh.uv is not None:
        vertices["s"], vertices["t"] = mesh.uv.T
    vertices["label"], vertices["material"] = mesh.label, mesh.material
    faces = np.empty(len(mesh.triangles), FACE)
    faces["count"], faces["corners"] = 3, mesh.triangles
    path.write_bytes(_header(vertices, len(faces)).encode() + vertices.tobytes() + faces.tobytes())


def write_obj(path: Path, mesh: LabelledMesh, texture: NDArray[np.uint8] | Colour) -> None:
    """Wavefront OBJ in metres, with its MTL, and with a PNG (H, W, 3) BGR that covers the texture coordinates.

    A mesh without texture coordinates takes one colour, in linear RGB.
    """
    name = path.stem
    lines = [f"mtllib {name}.mtl", f"o {name}"]
    lines += [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in (mesh.vertices_m + 0.0).tolist()]
    corners = (mesh.triangles + 1).tolist()
    if mesh.uv is None:
        faces = [f"f {a} {b} {c}" for a, b, c in corners]
    else:
        lines += [f"vt {u:.6f} {v:.6f}" for u, v in mesh.uv.tolist()]
        faces = [f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in corners]
    path.write_text("\n".join([*lines, f"usemtl {name}", *faces, ""]))
    path.with_suffix(".mtl").write_text(_material(name, texture))
    if isinstance(texture, np.ndarray):
        write_png(path.with_suffix(".png"), texture)


def write_png(path: Path, image: NDArray[np.uint8]) -> None:
    """Picture (H, W, 3) BGR as PNG; `OSError` if it cannot be written."""
    _, data = cv2.imencode(".png", image)
    path.write_bytes(data.tobytes())


def _header(vertices: NDArray[np.void], faces: int) -> str:
    names = vertices.dtype.names or ()
    properties = [f"property {PLY_TYPES[vertices.dtype[name].str[1:]]} {name}" for name in names]
    lines = ["ply", "format binary_little_endian 1.0", "comment metres; label 1: obstacle", "comment material: "]
    lines[-1] += ", ".join(f"{material.value} {material.name.lower()}" for material in Material)
    lines += [f"element vertex {len(vertices)}", *properties]
    return "\n".join([*lines, f"element face {faces}", "property list uchar int vertex_indices", "end_header", ""])


def _material(name: str, texture: NDArray[np.uint8] | Colour) -> str:
    """Matt: asphalt, rubber, wood and stone hardly shine."""
    if isinstance(texture, np.ndarray):
        colour, image = (1.0, 1.0, 1.0), [f"map_Kd {name}.png"]
    else:
        colour, image = texture, []
    diffuse = "Kd " + " ".join(f"{share:.4f}" for share in colour)
    return "\n".join([f"newmtl {name}", diffuse, "Ka 0 0 0", "Ks 0 0 0", "illum 1", *image, ""])
