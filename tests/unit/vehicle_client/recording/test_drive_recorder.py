from __future__ import annotations

import json
import subprocess
import sys
import textwrap
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from detector.types import FrameDetection
from tests.unit.vehicle_client.making import NOON_S, PATRAS, feature, map_of, planar, pose_at, seen, track_at
from vehicle_client.alerts import Alerts
from vehicle_client.drive import Step
from vehicle_client.obstacle_map import ObstacleMap
from vehicle_client.recording.drive_recorder import DriveRecorder, RecordingError
from vehicle_client.sensing.calibration import VehicleCalibration
from vehicle_client.sources.frame import GnssFix, LidarFrame, Motion
from vehicle_client.sources.opening import open_source

CALIBRATION = VehicleCalibration(planar(0.0, 0.0, 0.0, 1.73), "hdl64")


def measured(index: int, count: int = 200) -> LidarFrame:
    """A frame with everything in it."""
    rng = np.random.default_rng(index)
    stamp_s = NOON_S + 0.1 * index
    return LidarFrame(
        stamp_s,
        rng.normal(0, 10, (count, 3)).astype(np.float32),
        intensity=rng.random(count).astype(np.float32),
        ring=rng.integers(0, 64, count).astype(np.uint16),
        image=np.full((16, 24, 3), 60 + index, np.uint8),
        odom_from_vehicle=planar(float(index), 0.0, 0.1),
        gnss=GnssFix(PATRAS, 20.0, 1.25, 0.7, 1.5, course_rad=1.2, speed_mps=9.5, stamp_s=stamp_s - 0.03),
        steering_rad=0.02 * index,
        speed_mps=10.0,
        point_time_s=np.linspace(-0.1, 0, count).astype(np.float32),
        image_stamp_s=stamp_s - 0.02,
        motions=(Motion(stamp_s - 0.06, 9.9, 0.01), Motion(stamp_s - 0.01, 10.0, None)),
    )


def step(index: int, frame: LidarFrame | None = None) -> Step:
    frame = measured(index) if frame is None else frame
    count = len(frame.points_m)
    labels, floats = np.full(count, 5, np.uint8), np.zeros(count, np.float32)
    detection = FrameDetection(labels, floats, floats, (seen(),))
    here = pose_at(stamp_s=frame.stamp_s)
    return Step(
        frame=frame,
        pose=here,
        reason=None,
        detection=detection,
        found=(seen(),),
        tracks=(track_at(8.0, 0.5),),
        measured=(),
        known=map_of(feature(7)),
        alerts=Alerts(),
    )


def bare(index: int) -> Step:
    """Points alone, no pose, nothing found."""
    floats = np.zeros(5, np.float32)
    frame = LidarFrame(NOON_S + 0.1 * index, np.ones((5, 3), np.float32))
    nothing = FrameDetection(floats.astype(np.uint8), floats, floats, (), road_seen=False)
    return Step(
        frame=frame,
        pose=None,
        reason="no fix yet",
        detection=nothing,
        found=(),
        tracks=(),
        measured=(),
        known=ObstacleMap(),
        alerts=Alerts(fresh=False),
    )


def record(path: Path, steps: list[Step]) -> Path:
    with DriveRecorder(path, CALIBRATION, least_free_bytes=0) as recorder:
        for one in steps:
            recorder.add(one, np.full((32, 48, 3), 200, np.uint8))
    return path


def messages(path: Path) -> dict[str, list]:
    found: dict[str, list] = {}
    with path.open("rb") as stream:
        for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            found.setdefault(channel.topic, []).append(message.data)
    return found


def test_a_recording_is_a_source_that_gives_the_same_frames_again(tmp_path: Path) -> None:
    source = open_source(record(tmp_path / "drive.mcap", [step(i) for i in range(5)]))
    frames = list(source)
    assert len(source) == len(frames) == 5
    assert source.skipped == 0
    for index, frame in enumerate(frames):
        written = measured(index)
        for name in ("points_m", "intensity", "ring"):
            assert getattr(frame, name).tolist() == getattr(written, name).tolist(), name
        assert frame.point_time_s == pytest.approx(written.point_time_s, abs=1e-6)
        assert frame.stamp_s == pytest.approx(written.stamp_s, abs=1e-6)
        assert np.abs(frame.image.astype(int) - written.image).max() <= 2
        assert frame.image_stamp_s == pytest.approx(written.image_stamp_s, abs=1e-6)
        assert frame.odom_from_vehicle == pytest.approx(written.odom_from_vehicle)
        assert (frame.steering_rad, frame.speed_mps) == (written.steering_rad, written.speed_mps)
        for field in fields(GnssFix):
            if field.name != "position":
                assert getattr(frame.gnss, field.name) == pytest.approx(getattr(written.gnss, field.name), abs=1e-6)
        assert frame.gnss.position == written.gnss.position
        assert [(m.speed_mps, m.yaw_rate_rps) for m in frame.motions] == [(9.9, 0.01), (10.0, None)]
        assert [m.stamp_s for m in frame.motions] == pytest.approx([m.stamp_s for m in written.motions], abs=1e-6)


def test_frames_of_points_alone_come_back_as_such(tmp_path: Path) -> None:
    path = record(tmp_path / "drive.mcap", [bare(i) for i in range(3)])
    for frame in open_source(path):
        assert frame.image is None
        assert (frame.gnss, frame.odom_from_vehicle, frame.motions) == (None, None, ())
        assert (frame.intensity, frame.ring, frame.point_time_s) == (None, None, None)
    assert [json.loads(data) for data in messages(path)["/state"]] == [{"known": False, "reason": "no fix yet"}] * 3


def test_the_frame_as_it_was_measured_is_what_is_driven_again(tmp_path: Path) -> None:
    raw = measured(0)
    prepared = replace(raw, points_m=raw.points_m + 1, point_time_s=None, image=None, motions=())
    with DriveRecorder(tmp_path / "drive.mcap", CALIBRATION, least_free_bytes=0) as recorder:
        recorder.add(step(0, prepared), measured=raw)
    (frame,) = open_source(tmp_path / "drive.mcap")
    assert frame.points_m.tolist() == raw.points_m.tolist()
    assert frame.point_time_s == pytest.approx(raw.point_time_s, abs=1e-6)
    assert frame.image is not None
    assert len(frame.motions) == 2


def test_what_was_found_told_and_shown_is_in_the_file(tmp_path: Path) -> None:
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

    found = messages(record(tmp_path / "drive.mcap", [step(0)]))
    scene = SceneUpdate.FromString(found["/obstacles"][0])
    assert [entity.id for entity in scene.entities] == ["track-1", "00000000-0000-0000-0000-000000000007"]
    assert scene.entities[0].cubes[0].pose.position.x == 8.0
    assert scene.entities[1].cubes[0].size.x == pytest.approx(0.9)
    (detected,) = json.loads(found["/detections"][0])["found"]
    assert (detected["kind"], detected["length_m"], detected["centre_m"][0]) == ("pothole", 0.9, 10.0)
    assert json.loads(found["/alerts"][0])["hazards"] == []
    assert json.loads(found["/state"][0])["heading_rad"] == pytest.approx(np.pi / 2)
    assert len(found["/overlay"]) == len(found["/camera"]) == len(found["/tf"]) == len(found["/pose"]) == 1


def test_the_same_drive_gives_the_same_bytes(tmp_path: Path) -> None:
    first, second = (record(tmp_path / name, [step(i) for i in range(3)]) for name in ("a.mcap", "b.mcap"))
    assert first.read_bytes() == second.read_bytes()


def test_a_recording_never_replaces_another(tmp_path: Path) -> None:
    path = record(tmp_path / "drive.mcap", [bare(0)])
    with pytest.raises(RecordingError, match="is there already"):
        DriveRecorder(path, CALIBRATION)


def test_what_a_killed_process_left_is_kept(tmp_path: Path) -> None:
    for number in (1, 2):
        left = record(tmp_path / "whole.mcap", [bare(number)]).rename(tmp_path / "drive.mcap.part").read_bytes()
        record(tmp_path / "drive.mcap", [bare(0)]).unlink()
        assert (tmp_path / f"drive.unfinished-{number}.mcap").read_bytes() == left
    assert len(list(open_source(tmp_path / "drive.unfinished-1.mcap"))) == 1


def test_a_place_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="cannot be made"):
        DriveRecorder(tmp_path / "file" / "drive.mcap", CALIBRATION)


def test_a_nearly_full_disk_ends_the_recording_and_not_the_drive(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with DriveRecorder(tmp_path / "drive.mcap", CALIBRATION, least_free_bytes=2**62) as recorder:
        for index in range(3):
            recorder.add(bare(index))
    assert "GB are free" in recorder.stopped
    assert len(caplog.messages) == 1
    assert not (tmp_path / "drive.mcap.part").exists()


def test_a_disk_that_fails_ends_the_recording_and_not_the_drive(tmp_path: Path) -> None:
    (tmp_path / "drive.mcap.part").symlink_to("/dev/full")
    with DriveRecorder(tmp_path / "drive.mcap", CALIBRATION, least_free_bytes=0) as recorder:
        for index in range(3):
            recorder.add(step(index, measured(index, 100_000)))
    assert recorder.stopped == "No space left on device"
    assert not (tmp_path / "drive.mcap").exists()


def test_a_recording_that_cannot_be_given_its_name_says_so_and_keeps_what_was_written(tmp_path: Path) -> None:
    with DriveRecorder(tmp_path / "drive.mcap", CALIBRATION, least_free_bytes=0) as recorder:
        recorder.add(bare(0))
        (tmp_path / "drive.mcap").mkdir()
    assert recorder.stopped is not None
    assert recorder.stopped.startswith("cannot be finished: Is a directory")
    assert recorder.stopped.endswith(f"{tmp_path / 'drive.mcap.part'} has what was written")
    assert len(list(open_source(tmp_path / "drive.mcap.part"))) == 1


def test_a_recording_whose_process_was_killed_is_read_as_far_as_it_was_written(tmp_path: Path) -> None:
    program = f"""
    import os, signal, sys
    sys.path.insert(0, {str(Path(__file__).parents[4])!r})
    from pathlib import Path
    from tests.unit.vehicle_client.recording.test_drive_recorder import CALIBRATION, DriveRecorder, measured, step
    recorder = DriveRecorder(Path({str(tmp_path / "drive.mcap")!r}), CALIBRATION, least_free_bytes=0)
    for index in range(12):
        recorder.add(step(index, measured(index, 60_000)))
    os.kill(os.getpid(), signal.SIGKILL)
    """
    ended = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], check=False)
    assert ended.returncode == -9
    source = open_source(tmp_path / "drive.mcap.part")
    frames = list(source)
    assert 8 <= len(frames) <= 12
    assert [f.stamp_s for f in frames] == pytest.approx([NOON_S + 0.1 * i for i in range(len(frames))], abs=1e-6)
    assert source.skipped == 1
