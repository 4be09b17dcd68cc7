"""Labels and truth agree with the geometry of what was written; its bytes follow from options and seed alone."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from headsup.simulate.drive_options import DriveOptions
from simulator.changes import APPEARED, REMOVED, Change, ChangingStreet
from simulator.drive import tick_of
from simulator.mesh import pose
from simulator.record import RecordingPlan, drive_of, record, worlds_of
from simulator.recording.header import RecordingHeader
from simulator.recording.writer import EgoWriter, begin_recording, end_recording
from simulator.scenario import Scenario, ScenarioPlan, scenario
from simulator.scene.scenery import Surface
from simulator.sensors.sensor_rigs import RIGS
from simulator.streets.street import Roughness
from simulator.streets.world_plan import WorldPlan

GUIDE = Path(__file__).parents[2] / "docs/datasets.md"
LIDAR = next(entry for entry in RIGS["hdl32"]() if "lidar" in str(entry["type"]))
HEIGHT_M = 1.84

CHANGE_S = 0.45
"""Ego 0 sees the street before and after it, ego 1 starts later."""

NOISE_M = 0.05
"""Range noise of some millimetres and ring constants of 13 mm; footprints are sampled every centimetre."""


@dataclass(frozen=True)
class Turn:
    """One sweep as it was written, its points where they lay in the frame `street` when they were measured."""

    ego: int
    time_s: float
    points_m: np.ndarray
    labels: dict[str, np.ndarray]


@dataclass(frozen=True)
class Written:
    folder: Path
    happening: Scenario
    removed: int
    appeared: int
    turns: list[Turn]

    @property
    def truth(self) -> list[dict[str, object]]:
        return json.loads((self.folder / "obstacles.json").read_text())


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    """One second of two moving vehicles on a road full of obstacles, of which one goes and one appears."""
    folder = tmp_path_factory.mktemp("labels") / "run"
    world = WorldPlan(roughness=Roughness.A, obstacles_per_100m=8.0)
    drawn = scenario(ScenarioPlan(seed=76, egos=2, seconds=1.0, changes=False, world=world))
    removed, appeared = _ahead(drawn)
    changes = (Change(CHANGE_S, removed, REMOVED), Change(CHANGE_S, appeared, APPEARED))
    happening = replace(drawn, changing=ChangingStreet(drawn.changing.street, changes))
    plan = RecordingPlan(drawn.plan, [LIDAR], mcap=False)
    street, truth, worlds = happening.changing.street, happening.changing.truth(), worlds_of(happening)
    header = RecordingHeader(
        "tests", 76, plan.start, tick_of(plan.rig), street.georeference, street.enu_from_street, plan.sensors
    )
    begin_recording(folder, header, truth)
    summaries = []
    for ego in range(2):
        with EgoWriter(folder, ego, header, truth, mcap=False) as recording:
            for frame in drive_of(happening, ego, plan.rig, worlds):
                recording.write(frame)
        summaries.append(recording.summary)
    end_recording(folder, header, summaries)
    turns = [turn for ego in range(2) for turn in _turns(folder, ego)]
    return Written(folder, happening, removed, appeared, turns)


def _ahead(happening: Scenario) -> tuple[int, int]:
    """The nearest hole ahead of ego 0 when things change, and the nearest other obstacle."""
    here = happening.egos[0].trajectory.poses(np.array([CHANGE_S]))[0]
    near = []
    for placed in happening.changing.street.obstacles:
        ahead, left = (np.array([placed.x_m, placed.y_m]) - here[:2, 3]) @ here[:2, :2]
        if 8.0 < ahead < 30.0 and abs(left) < 5.0:
            near.append((ahead, placed))
    near.sort(key=lambda pair: pair[0])
    hole = next(placed for _, placed in near if placed.kind == "pothole")
    return hole.obstacle_id, next(p for _, p in near if p.obstacle_id != hole.obstacle_id).obstacle_id


def _turns(folder: Path, ego: int) -> list[Turn]:
    """Points of all sweeps but the first, for which there is no earlier pose to interpolate from."""
    with (folder / f"ego{ego}/poses.csv").open() as file:
        rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    times = np.array([row["time_s"] for row in rows])
    positions = np.array([[row[f"{axis}_m"] for axis in "xyz"] for row in rows])
    turning = Slerp(times, Rotation.from_quat([[row[f"q{axis}"] for axis in "xyzw"] for row in rows]))
    vehicle_from_sensor = pose(0.0, 0.0, HEIGHT_M)
    turns = []
    for row in rows[1:]:
        name = folder / f"ego{ego}" / str(LIDAR["type"]) / f"{int(row['frame']):05d}.ply"
        points = np.loadtxt(name, skiprows=name.read_text().split("end_header")[0].count("\n") + 1)[:, :3]
        labels = dict(np.load(name.parent / "labels" / f"{name.stem}.npz"))
        at = np.clip(row["time_s"] + labels["time_offset_s"], times[0], times[-1])
        in_vehicle = points * (1, -1, 1) + vehicle_from_sensor[:3, 3]
        places = np.stack([np.interp(at, times, positions[:, axis]) for axis in range(3)], axis=1)
        turns.append(Turn(ego, row["time_s"], turning(at).apply(in_vehicle) + places, labels))
    return turns


def _rows_at(truth: list[dict[str, object]], time_s: float) -> dict[int, dict[str, object]]:
    """The latest row of each obstacle that lies there at a time."""
    latest = {row["obstacle_id"]: row for row in truth if row["from_s"] <= time_s}
    return {number: row for number, row in latest.items() if row["change"] != "removed"}


def test_points_of_an_obstacle_lie_in_the_box_that_obstacles_json_states_and_no_others_inside_it_are_missed(
    written: Written,
) -> None:
    enu_from_street = np.array(json.loads((written.folder / "recording.json").read_text())["enu_from_street"])
    seen: dict[str, int] = {}
    for turn in written.turns:
        enu = turn.points_m @ enu_from_street[:3, :3].T + enu_from_street[:3, 3]
        rows = _rows_at(written.truth, turn.time_s)
        assert set(np.unique(turn.labels["obstacle_id"])) <= {0, *rows}
        for number, row in rows.items():
            offset = enu - row["enu_m"]
            cos, sin = math.cos(row["yaw_rad"]), math.sin(row["yaw_rad"])
            along, across = offset[:, 0] * cos + offset[:, 1] * sin, offset[:, 1] * cos - offset[:, 0] * sin
            excess = np.maximum(np.abs(along) - row["length_m"] / 2, np.abs(across) - row["width_m"] / 2)
            labelled = turn.labels["obstacle_id"] == number
            seen[row["kind"]] = seen.get(row["kind"], 0) + int(labelled.sum())
            # A beam that meets an edge and what lies behind it measures something between.
            assert (excess[labelled] < NOISE_M).mean() > 0.9 if labelled.any() else True
            assert (excess[labelled] < 0.5).all()
    assert set(seen) == {"pothole", "bump", "debris"}
    assert min(seen.values()) > 20


def test_road_points_within_a_footprint_carry_its_number_and_those_beside_it_do_not(written: Written) -> None:
    inside = beside = 0
    for turn in written.turns:
        for placed in written.happening.changing.at(turn.time_s).obstacles:
            x, y, _ = turn.points_m.T
            near = np.hypot(x - placed.x_m, y - placed.y_m) < 4.0
            near &= turn.labels["surface"] == Surface.ROAD
            if placed.kind == "debris" or not near.any():
                continue
            around = [(0, 0), (NOISE_M, 0), (-NOISE_M, 0), (0, NOISE_M), (0, -NOISE_M)]
            covered = np.array([placed.covers(x[near] + dx, y[near] + dy) for dx, dy in around])
            is_its = turn.labels["obstacle_id"][near] == placed.obstacle_id
            if not placed.filled:
                assert is_its[covered.all(axis=0)].all()
                inside += int(covered.all(axis=0).sum())
            assert not is_its[~covered.any(axis=0)].any()
            beside += int((~covered.any(axis=0)).sum())
    assert inside > 50
    assert beside > 500


def test_holes_lie_below_the_road_and_bumps_and_debris_above_it(written: Written) -> None:
    street = written.happening.changing.street
    heights: dict[int, list[float]] = {}
    for turn in written.turns:
        labelled = np.flatnonzero(turn.labels["obstacle_id"])
        over = turn.points_m[labelled, 2] - street.sound_height(*turn.points_m[labelled, :2].T)
        for number, height in zip(turn.labels["obstacle_id"][labelled], over, strict=True):
            heights.setdefault(int(number), []).append(float(height))
    many = {number: np.array(values) for number, values in heights.items() if len(values) >= 20}
    assert len(many) >= 4
    for number, over in many.items():
        placed = street.obstacle(number)
        if placed.kind == "pothole":
            # Rims stand up by a centimetre, walls are half as deep.
            assert over.mean() < -0.15 * placed.shape.relief_m
            assert over.min() > -placed.shape.relief_m - NOISE_M
        else:
            assert over.mean() > 0.2 * placed.shape.relief_m
            assert over.max() < placed.shape.relief_m + NOISE_M


def test_what_was_removed_is_gone_after_its_time_and_the_road_there_is_sound(written: Written) -> None:
    street, number = written.happening.changing.street, written.removed
    placed = street.obstacle(number)
    counts = {False: 0, True: 0}
    depths: list[np.ndarray] = []
    for turn in written.turns:
        is_after = turn.time_s > CHANGE_S
        counts[is_after] += int((turn.labels["obstacle_id"] == number).sum())
        inside = placed.covers(*turn.points_m[:, :2].T) & (turn.labels["surface"] == Surface.ROAD)
        if is_after and inside.any():
            depths.append(turn.points_m[inside, 2] - street.sound_height(*turn.points_m[inside, :2].T))
    assert counts[False] > 5
    assert counts[True] == 0
    assert np.abs(np.concatenate(depths)).max() < NOISE_M
    assert abs(np.concatenate(depths).mean()) < 0.015


def test_what_appears_is_seen_from_its_time_on_only(written: Written) -> None:
    rows = [row for row in written.truth if row["obstacle_id"] == written.appeared]
    assert [(row["change"], row["from_s"]) for row in rows] == [("appeared", CHANGE_S)]
    before, after = (
        sum(
            int((t.labels["obstacle_id"] == written.appeared).sum())
            for t in written.turns
            if (t.time_s > CHANGE_S) == is_after
        )
        for is_after in (False, True)
    )
    assert before == 0
    assert after > 5


def test_points_of_a_moving_thing_lie_about_it_and_no_vehicle_sees_itself(written: Written) -> None:
    movers = {mover.number: mover for mover in written.happening.movers}
    kinds = {Surface.CAR, Surface.WHEEL, Surface.PEDESTRIAN}
    seen = set()
    for turn in written.turns:
        number = turn.labels["mover_id"]
        assert written.happening.egos[turn.ego].mover not in number
        for one in set(number.tolist()) - {0}:
            of_it = number == one
            at = movers[one].motion.poses(turn.time_s + turn.labels["time_offset_s"][of_it].astype(float))[:, :3, 3]
            apart = np.hypot(*(turn.points_m[of_it] - at)[:, :2].T)
            assert (apart < movers[one].model.radius_m + NOISE_M).mean() > 0.9
            assert set(turn.labels["surface"][of_it].tolist()) <= set(map(int, kinds))
            seen.add(one)
    assert len(seen) >= 3


def test_the_lines_of_the_guide_load_a_recording(
    written: Written, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = GUIDE.read_text().split("## Loading")[1].split("```python\n")[1].split("```")[0]
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs/0001").symlink_to(written.folder)
    monkeypatch.chdir(tmp_path)
    loaded: dict[str, object] = {}
    exec(compile(lines, str(GUIDE), "exec"), loaded)  # noqa: S102  # our own documentation
    kinds = {placed.obstacle_id: placed.kind.value for placed in written.happening.changing.street.obstacles}
    assert loaded["seen"]
    for (number, kind), hits in loaded["seen"].items():
        assert kind == kinds[number]
        of_ego0 = [turn for turn in written.turns if turn.ego == 0]
        expected = {turn.time_s: int((turn.labels["obstacle_id"] == number).sum()) for turn in of_ego0}
        assert {time_s: count for time_s, count, _ in hits if time_s in expected} == {
            time_s: count for time_s, count in expected.items() if count
        }


SENSORS = [
    {
        "type": "sensor.camera.rgb",
        "role_name": "front",
        "image_size_x": 96,
        "image_size_y": 48,
        "transform": [{"z": 1.6}],
    },
    {**LIDAR, "channels": 16, "points_per_second": 60_000, "rotation_frequency": 10.0} | {"headsup_preset": "carla"},
    {"type": "sensor.other.gnss", "role_name": "gnss", "transform": [{"z": 1.5}]},
    {"type": "sensor.other.imu", "role_name": "imu", "transform": [{"z": 0.5}]},
]


def _hashes(folder: Path) -> dict[str, str]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.mark.soak
def test_a_data_set_that_was_killed_is_gone_on_with_to_the_same_bytes_as_a_drive_by_itself(tmp_path: Path) -> None:
    sensors, out = tmp_path / "sensors.json", tmp_path / "set"
    sensors.write_text(json.dumps({"sensors": SENSORS}))
    command = [
        *(sys.executable, "-m", "headsup.cli", "simulate", "dataset", "--out", str(out), "--drives", "1"),
        *("--first-seed", "5", "--seconds", "0.5", "--sensors", str(sensors), "--no-traffic"),
    ]
    with subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL) as process:
        while not (out / "0001/ego1/poses.csv").exists() and process.poll() is None:
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGKILL)
    assert (out / "0001/ego1/poses.csv").exists()
    assert not (out / "0001/recording.json").exists()
    assert not (out / "dataset.json").exists()

    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    described = json.loads((out / "dataset.json").read_text())
    assert [drive["seed"] for drive in described["drives"]] == [5]
    assert described["totals"]["frames"] == described["totals"]["pictures"] == 2 * 5

    plan = DriveOptions(seconds=0.5, sensors=str(sensors), traffic=False).planner()
    record(plan(5), tmp_path / "alone", lambda _: None)
    alone, repaired = _hashes(tmp_path / "alone"), _hashes(out / "0001")
    assert alone == repaired
    assert {"ego0.mcap", "ego1.mcap", "overview.png", "obstacles.json", "ego1/poses.csv"} <= set(alone)
