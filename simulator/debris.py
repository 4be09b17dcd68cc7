"""Things that lie on the road: meshes standing on z = 0 about the middle of their plan."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, Delaunay

from simulator.mesh import Mesh, box, joined, pose

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Debris:
    """A thing on the road; its footprint is the convex hull of its plan."""

    mesh: Mesh

    @property
    def length_m(self) -> float:
        """Extent along the local x."""
        return float(np.ptp(self.mesh.vertices_m[:, 0]))

    @property
    def width_m(self) -> float:
        """Extent along the local y."""
        return float(np.ptp(self.mesh.vertices_m[:, 1]))

    @property
    def relief_m(self) -> float:
        """Height above the road."""
        return float(self.mesh.vertices_m[:, 2].max())

    @property
    def footprint_area_m2(self) -> float:
        """Area of the plan's convex hull."""
        return float(ConvexHull(self.mesh.vertices_m[:, :2]).volume)

    @property
    def volume_m3(self) -> float:
        """Volume of the convex hull: what a car meets, not the wood alone."""
        return float(ConvexHull(self.mesh.vertices_m).volume)

    @property
    def reach_m(self) -> float:
        """Radius about the centre that holds the whole thing."""
        return float(np.hypot(*self.mesh.vertices_m[:, :2].T).max())

    def covers(self, x_m: FloatArray, y_m: FloatArray) -> NDArray[np.bool_]:
        """Whether local positions lie inside the footprint."""
        plan = Delaunay(self.mesh.vertices_m[:, :2])
        return np.asarray(plan.find_simplex(np.stack([x_m, y_m], axis=-1)) >= 0)

    def grown(self, area_factor: float) -> Debris:
        """The same thing with `area_factor` times the footprint's area and the same height."""
        side = math.sqrt(area_factor)
        return Debris(self.mesh.scaled(side, side, 1.0))


def broken_pallet(seed: int, length_m: float, width_m: float, height_m: float) -> Debris:
    """Half a wooden pallet that came down on a block: boards on three bearers, one side raised, one board loose."""
    rng = np.random.default_rng(seed)
    bearers = [box(1.0, 0.09, 0.10).moved(pose(0, y, 0)) for y in (-0.38, 0.0, 0.38)]
    xs = np.linspace(-0.43, 0.43, 6) + rng.normal(0, 0.01, 6)
    boards = [box(0.11, 0.86, 0.022).moved(pose(x, 0, 0.10, rng.normal(0, 0.02))) for x in xs]
    loose = box(0.10, 0.62, 0.02).moved(pose(0.12, -0.05, 0.16, rng.uniform(0.5, 0.9), roll_rad=0.12))
    block = box(0.20, 0.20, 0.14).moved(pose(-0.33, 0.20, 0.0, 0.3))
    # Its front edge, at x = 0.5, stays on the road.
    raised = joined([*bearers, *boards, loose]).moved(pose(0, 0, 0.5 * math.sin(0.16), pitch_rad=0.16))
    return Debris(_fitted(joined([raised, block]), length_m, width_m, height_m))


def _fitted(mesh: Mesh, length_m: float, width_m: float, height_m: float) -> Mesh:
    """The mesh moved and stretched to fill a box about the z axis on z = 0."""
    low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
    shift = pose(-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2])
    stretch = np.array([length_m, width_m, height_m]) / (high - low)
    return mesh.moved(shift).scaled(*stretch)
