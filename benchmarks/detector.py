"""How fast the detector is: against a plain port of the published method, against its peers, and as clouds grow.

In each round every method sees the same sweep, one after the other, so that what else the machine does falls on all.
The port takes seconds to minutes and runs once for each size, between rounds. Peers are scored on the same sweeps: of
the four obstacles of the demo's street, each seen from 10 m, how many have a cluster within 0.6 m of their hits, and
how many clusters lie elsewhere. With `--data` real sweeps (`kitti_sequence/velodyne/*.bin`), whose road is sound, take
the place of simulated ones.

Examples:

    python -m benchmarks.detector --rounds 20

    python -m benchmarks.detector --data data --no-port
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.published_method import (
    alternating_minimisation,
    augmented_lagrange_multipliers,
    published_saliency,
)
from benchmarks.simulator import Driving
from detector.pipeline import detect
from detector.saliency.cloud_saliency import saliency_map
from detector.types import DetectorInput
from evaluation.peers import SWEEP_PEERS
from simulator.mesh import pose
from simulator.sensors.lidar import LidarModel
from simulator.sensors.lidar_presets import LIDAR_PRESETS
from simulator.streets.street import LANE_CENTRE_M, first_light_street
from simulator.world import World

FloatArray = NDArray[np.float64]

STREET_SEED = 3
DISTANCE_M = 10.0
FOUND_WITHIN_M = 0.6
ROAD_HALF_WIDTH_M = 3.5
AHEAD_M = 40.0
BEHIND_M = 20.0
KITTI_HEIGHT_M = 1.73
TOP_SHARE = 0.1
# A car at 25 km/h between two turns.
TURN_STEP_M = 0.7
SIZES = (125_000, 250_000, 500_000, 1_000_000, 2_000_000)

PORTS = {
    "port, RPCA of the paper's appendix": alternating_minimisation,
    "port, RPCA by ALM": augmented_lagrange_multipliers,
}


@dataclass(frozen=True, slots=True)
class Sweep:
    """Points (N, 3) of a turn in the `sensor` frame, and the centres (M, 3) of the obstacles it shall show."""

    points_m: NDArray[np.float32]
    height_m: float
    obstacles_m: FloatArray

    @property
    def on_road(self) -> NDArray[np.bool_]:
        """Mask (N,) of the strip that the peers are given."""
        x, y = self.points_m[:, 0], self.points_m[:, 1]
        return (np.abs(y) < ROAD_HALF_WIDTH_M) & (x > -BEHIND_M) & (x < AHEAD_M)


Method = Callable[[Sweep], Sequence[FloatArray]]
"""Centres (3,) of what it calls obstacles on the road."""


@dataclass(frozen=True, slots=True)
class Standing:
    """A sensor that does not move, `ahead_m` before a place of the street."""

    x_m: float
    height_m: float

    def poses(self, time_s: FloatArray) -> FloatArray:
        """Poses (N, 4, 4) at times (N,)."""
        return np.tile(pose(self.x_m, LANE_CENTRE_M, self.height_m), (len(time_s), 1, 1))


def default_detector(sweep: Sweep) -> Sequence[FloatArray]:
    """From array to obstacles."""
    return [o.centre_m for o in detect(DetectorInput(sweep.points_m, sweep.height_m)).obstacles]


def papers_method(sweep: Sweep) -> Sequence[FloatArray]:
    """The paper's method, from array to obstacles."""
    return [o.centre_m for o in detect(DetectorInput(sweep.points_m, sweep.height_m), "saliency").obstacles]


def whole_saliency(sweep: Sweep) -> Sequence[FloatArray]:
    """The saliency map of all points; it names no obstacle."""
    saliency_map(sweep.points_m.astype(np.float64))
    return []


def peer(name: str) -> Method:
    """One of the peers, from array to clusters on the road."""

    def run(sweep: Sweep) -> Sequence[FloatArray]:
        points = sweep.points_m.astype(np.float64)
        return [points[c].mean(axis=0) for c in SWEEP_PEERS[name](points, sweep.height_m, sweep.on_road)]

    return run


METHODS: dict[str, Method] = {
    "HeadsUp `surface`, array to obstacles": default_detector,
    "HeadsUp `saliency`, array to obstacles": papers_method,
    "HeadsUp `saliency_map`, k = 30, alone": whole_saliency,
    **{name: peer(name) for name in SWEEP_PEERS},
}


def street_sweeps(preset: str) -> list[Sweep]:
    """The demo's street, each of its obstacles seen from 10 m."""
    street = first_light_street(seed=STREET_SEED)
    world, lidar, rng = World(street), LIDAR_PRESETS[preset](), np.random.default_rng(1)
    return [_sweep_before(world, lidar, o.x_m, o.obstacle_id, rng) for o in street.obstacles]


def _sweep_before(world: World, lidar: LidarModel, x_m: float, obstacle_id: int, rng: np.random.Generator) -> Sweep:
    turn = world.sweep(lidar, Standing(x_m - DISTANCE_M, lidar.height_m), 0.0, rng)
    hits = turn.points_m[turn.obstacle_id == obstacle_id]
    return Sweep(turn.points_m.astype(np.float32), lidar.height_m, hits.mean(axis=0, dtype=np.float64)[None])


def real_sweeps(folder: Path) -> list[Sweep]:
    """Sweeps of an HDL-64E on a sound road."""
    files = sorted((folder / "kitti_sequence" / "velodyne").glob("*.bin"))
    clouds = [np.fromfile(f, np.float32).reshape(-1, 4)[:, :3] for f in files]
    return [Sweep(np.ascontiguousarray(cloud), KITTI_HEIGHT_M, np.empty((0, 3))) for cloud in clouds]


def time_methods(sweeps: Sequence[Sweep], rounds: int) -> dict[str, FloatArray]:
    """Milliseconds (rounds,) of each method, all on the sweep of the round in turn."""
    for method in METHODS.values():
        method(sweeps[0])
    taken: dict[str, list[float]] = {name: [] for name in METHODS}
    for count in range(rounds):
        for name, method in METHODS.items():
            taken[name].append(_milliseconds(method, sweeps[count % len(sweeps)]))
    return {name: np.array(values) for name, values in taken.items()}


def scores(method: Method, sweeps: Sequence[Sweep]) -> tuple[int, int, float]:
    """Obstacles found, obstacles there, and other clusters a sweep."""
    found = others = 0
    for sweep in sweeps:
        centres = np.reshape(method(sweep), (-1, 3))
        gaps = np.linalg.norm(centres[:, None, :2] - sweep.obstacles_m[None, :, :2], axis=2)
        found += int((gaps < FOUND_WITHIN_M).any(axis=0).sum())
        others += int((~(gaps < FOUND_WITHIN_M).any(axis=1)).sum())
    return found, sum(len(s.obstacles_m) for s in sweeps), others / len(sweeps)


def print_methods(title: str, sweeps: Sequence[Sweep], rounds: int) -> None:
    """One table of all methods."""
    points = int(np.median([len(s.points_m) for s in sweeps]))
    print(f"\n### {title}: {points:,} points, {len(sweeps)} sweeps, {rounds} rounds\n")
    print(
        "| method | median ms | 95th percentile ms | obstacles found | other clusters a sweep |\n|---|---|---|---|---|"
    )
    taken = time_methods(sweeps, rounds)
    for name, milliseconds in taken.items():
        found, there, others = scores(METHODS[name], sweeps)
        names_obstacles = METHODS[name] is not whole_saliency
        score = (f"{found}/{there}" if there else "-", f"{others:.2f}") if names_obstacles else ("-", "-")
        cells = (name, f"{np.median(milliseconds):.1f}", f"{np.percentile(milliseconds, 95):.1f}", *score)
        print("| " + " | ".join(cells) + " |", flush=True)


def print_ports(sweep: Sweep) -> None:
    """The port against our map, measured before and after it: times, correlation, overlap of the most salient tenth."""
    points = sweep.points_m.astype(np.float64)
    ours = saliency_map(points)
    print(f"\n### Saliency map of {len(points):,} points against the published method\n")
    print("| method | s | CPU s | ours ms | CPU ms | times faster | times less CPU | correlation | overlap |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name, robust_pca in PORTS.items():
        before = _own_times(sweep)
        start, start_cpu = time.perf_counter(), time.process_time()
        theirs = published_saliency(points, robust_pca)
        taken, taken_cpu = time.perf_counter() - start, time.process_time() - start_cpu
        own, own_cpu = np.median(before + _own_times(sweep), axis=0)
        cells = (f"{taken:.2f}", f"{taken_cpu:.2f}", f"{1e3 * own:.1f}", f"{1e3 * own_cpu:.1f}")
        ratios = (f"{taken / own:.0f}", f"{taken_cpu / own_cpu:.0f}")
        agreement = (f"{np.corrcoef(ours, theirs)[0, 1]:.4f}", f"{_overlap(ours, theirs):.4f}")
        print("| " + " | ".join((name, *cells, *ratios, *agreement)) + " |", flush=True)


def _own_times(sweep: Sweep) -> list[tuple[float, float]]:
    """Seconds and seconds of CPU time, of both cores, of ten calls of our map."""
    times = []
    for _ in range(10):
        start, start_cpu = time.perf_counter(), time.process_time()
        whole_saliency(sweep)
        times.append((time.perf_counter() - start, time.process_time() - start_cpu))
    return times


def _milliseconds(method: Method, sweep: Sweep) -> float:
    start = time.perf_counter()
    method(sweep)
    return 1e3 * (time.perf_counter() - start)


def _median_ms(method: Method, sweep: Sweep, repeats: int) -> float:
    return float(np.median([_milliseconds(method, sweep) for _ in range(repeats)]))


def _overlap(a: FloatArray, b: FloatArray) -> float:
    top = int(TOP_SHARE * len(a))
    return len(np.intersect1d(np.argsort(a)[-top:], np.argsort(b)[-top:])) / top


def print_growth() -> None:
    """Time a point as the cloud grows: turns of an HDL-64E along the street in one frame."""
    world, lidar, rng = World(first_light_street(seed=STREET_SEED)), LIDAR_PRESETS["hdl64"](), np.random.default_rng(2)
    turns: list[NDArray[np.float32]] = []
    while sum(map(len, turns)) < SIZES[-1]:
        shift_m = np.array([TURN_STEP_M * len(turns), 0.0, 0.0])
        turn = world.sweep(lidar, Driving(lidar.height_m), shift_m[0] / 10.0, rng).points_m
        turns.append((turn + shift_m).astype(np.float32))
    print("\n### As clouds grow\n")
    print("| points | `saliency_map` ms | ns a point | `surface` ms | ns a point |\n|---|---|---|---|---|")
    cloud = np.vstack(turns)
    for size in SIZES:
        sweep = Sweep(cloud[:size], lidar.height_m, np.empty((0, 3)))
        taken = [_median_ms(method, sweep, 3) for method in (whole_saliency, default_detector)]
        print(f"| {size:,} | " + " | ".join(f"{ms:.0f} | {1e6 * ms / size:.0f}" for ms in taken) + " |", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder with kitti_sequence, for real sweeps")
    parser.add_argument("--rounds", type=int, default=20, help="sweeps to time each method on (default 20)")
    parser.add_argument("--no-port", action="store_true", help="leave out the port, which takes minutes")
    options = parser.parse_args()
    if options.rounds < 1:
        parser.error("--rounds must be 1 or more")
    real = real_sweeps(options.data) if options.data else []
    if options.data and not real:
        parser.error(f"no kitti_sequence/velodyne/*.bin in {options.data}")
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} before, street seed {STREET_SEED}")
    first = street_sweeps("paper")
    print(f"first call of `surface` in this process: {_milliseconds(default_detector, first[0]):.0f} ms")
    large = real or street_sweeps("hdl64")
    for title, sweeps in (
        ("Simulated, the paper's preset", first),
        ("Real HDL-64E" if real else "Simulated HDL-64E", large),
    ):
        print_methods(title, sweeps, options.rounds)
        if not options.no_port:
            print_ports(sweeps[0])
    print_growth()


if __name__ == "__main__":
    main()
