"""On real sweeps the fast map is the whole scheme's."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from detector.saliency.cloud_saliency import geometric_saliency, saliency_map, scale_to_unit
from detector.saliency.normals import pca_normals
from detector.saliency.spectral import inverse_frobenius

DATA = Path(os.environ.get("HEADSUP_DATA", Path(__file__).parents[4] / "shared" / "data"))

pytestmark = pytest.mark.realdata


def test_the_map_of_a_real_sweep_agrees_with_the_whole_scheme() -> None:
    files = sorted(DATA.glob("kitti_sequence/velodyne/*.bin"))
    if not files:
        pytest.skip(f"no kitti_sequence/velodyne/*.bin under {DATA}: set HEADSUP_DATA")
    points = np.fromfile(files[0], np.float32).reshape(-1, 4)[::3, :3].astype(np.float64)
    near = np.asarray(cKDTree(points).query(points, k=31)[1])
    around = pca_normals(points, near)[near]
    whole = 0.5 * scale_to_unit(geometric_saliency(around)) + 0.5 * scale_to_unit(inverse_frobenius(around))
    swift = saliency_map(points)
    top = len(points) // 10
    shared = np.intersect1d(np.argsort(whole)[-top:], np.argsort(swift)[-top:])
    assert np.corrcoef(whole, swift)[0, 1] > 0.99
    assert len(shared) > 0.95 * top
