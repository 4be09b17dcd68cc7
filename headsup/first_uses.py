"""First uses of the inner loops, on made-up data of the types that drives have: numba compiles and keeps them."""

from __future__ import annotations

import multiprocessing
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from detector.pipeline import detect, estimate_sensor_height
from detector.road.ground import road_coordinates
from detector.saliency.cloud_saliency import saliency_map
from detector.types import DetectorInput
from vehicle_client.frames import rigid
from vehicle_client.sensing.calibration import VehicleCalibration
from vehicle_client.sensing.calibration_file import CarCalibration
from vehicle_client.sensing.preparation import Preparation
from vehicle_client.sources.frame import LidarFrame
from vehicle_client.sources.number_text import parse_numbers
from vehicle_client.warming import load_compiled

HEIGHT_M = 1.8
HOLE_M = (14.0, 0.0, -0.1)
"""Before the first sweep's sensor, and how deep below the road; 0.9 m wide."""

PARALLEL = 2
"""Groups at once: compiling one keeps a core busy."""


def compile_all() -> Iterator[str]:
    """Compiles what this machine's installation can use, and yields the name of each group that is done.

    What an earlier process has compiled is only loaded. Raises RuntimeError if a group failed.
    """
    groups: dict[str, Callable[[], None]] = {"detector": _see_a_street, "matching and other clouds": _use_the_rest}
    if find_spec("open3d") is not None:
        groups["simulator"] = _simulate
    with ProcessPoolExecutor(PARALLEL, mp_context=multiprocessing.get_context("spawn")) as pool:
        names = {pool.submit(use): name for name, use in groups.items()}
        for done in as_completed(names):
            done.result()
            yield names[done]


def _road(car_x_m: float) -> NDArray[np.float32]:
    """A sweep (N, 3) of a street with a hole, walls on both sides, in the frame `sensor`."""
    noise = np.random.default_rng(1)
    x, y = (grid.ravel() for grid in np.meshgrid(np.arange(-15, 25, 0.12), np.arange(-6, 6, 0.12)))
    in_hole = np.maximum(np.abs(x + car_x_m - HOLE_M[0]), np.abs(y - HOLE_M[1])) < 0.45
    ground = np.column_stack([x, y, noise.normal(-HEIGHT_M, 0.003, x.size) + np.where(in_hole, HOLE_M[2], 0.0)])
    along, up = (grid.ravel() for grid in np.meshgrid(np.arange(-15, 25, 0.5), np.arange(-HEIGHT_M, 2, 0.2)))
    walls = [np.column_stack([along, np.full(along.size, side), up]) for side in (-6.0, 6.0)]
    return np.concatenate([ground, *walls]).astype(np.float32)


def _see_a_street() -> None:
    """What a drive does with sweeps, from the sensor's height to measuring and inspecting what was passed."""
    estimate_sensor_height(_road(0.0))
    load_compiled()


def _use_the_rest() -> None:
    """What not every drive needs: odometry from sweeps of a spinning sensor, text, the paper's method, surveys."""
    height = rigid(np.eye(3), np.array([0.0, 0.0, HEIGHT_M]))
    preparation = Preparation(CarCalibration(VehicleCalibration(height, sensor="lidar")))
    for number in range(3):
        points = _road(0.5 * number)
        times = np.linspace(-0.1, 0.0, len(points), dtype=np.float32)
        preparation.prepared(LidarFrame(0.1 * number, points, point_time_s=times))
    preparation.close()
    parse_numbers(b"1.5 -2e1\n")
    cloud = points.astype(np.float64)
    road_coordinates(cloud, 0.0)
    for from_faces in (False, True):
        saliency_map(cloud, from_faces=from_faces)
    near = points[np.abs(points - np.array([HOLE_M[0] - 1.0, 0.0, -HEIGHT_M])).max(axis=1) < 2.0]
    for method in ("surface", "saliency"):
        detect(DetectorInput(near, None), method)


def _simulate() -> None:
    """A drive of two sweeps, in a process as a user would begin it."""
    with TemporaryDirectory(prefix="headsup-") as folder:
        options = ("--seconds", "0.2", "--egos", "1", "--no-images", "--no-mcap", "--sensors", "hdl64")
        command = (sys.executable, "-m", "headsup.cli", "simulate", "drive", "--out", Path(folder) / "drive", *options)
        done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603  # ourselves
    if done.returncode != 0:
        raise RuntimeError((done.stderr.strip().splitlines() or ["the simulator ended without a word"])[-1])
