"""The drive: what a frame brings when the server, the pose or the road are not as one would wish."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from contract.events import Appeared, ServerMessage
from contract.observation import ObservationReport, ReportResult
from tests.unit.vehicle_client.making import ORIGIN, PATRAS, feature, planar
from vehicle_client.drive import Step, Vehicle
from vehicle_client.frames import rigid
from vehicle_client.link.server_link import ServerLink
from vehicle_client.positioning.pose import ODOMETRY_ALONE, PoseFilter, StatedPlace
from vehicle_client.sensing.calibration import VehicleCalibration
from vehicle_client.sources.frame import GnssFix, LidarFrame
from vehicle_client.totals import Totals

CALIBRATION = VehicleCalibration(rigid(np.eye(3), np.array([0.0, 0.0, 2.4])), sensor="test")


class HeldLink:
    """Stands where `ServerLink` does: says what it is given, keeps what is put, answers nothing."""

    def __init__(self, *told: ServerMessage) -> None:
        self.told = list(told)
        self.heard_at: list[object] = []
        self.deliveries = 0
        self.reports: list[ObservationReport] = []

    def hear(self, position: object) -> list[ServerMessage]:
        self.heard_at.append(position)
        said, self.told = self.told, []
        return said

    def put(self, report: ObservationReport) -> None:
        self.reports.append(report)

    def deliver(self) -> list[ReportResult]:
        self.deliveries += 1
        return []


def flat_road(spacing_m: float = 0.15) -> np.ndarray:
    x, y = np.meshgrid(np.arange(-15, 25, spacing_m), np.arange(-6, 6, spacing_m))
    random = np.random.default_rng(1)
    return np.column_stack([x.ravel(), y.ravel(), random.normal(-2.4, 0.005, x.size)]).astype(np.float32)


def frame_at(x_m: float, stamp_s: float) -> LidarFrame:
    fix = GnssFix(PATRAS, 60.0, heading_rad=np.pi / 2, sd_m=1.0, altitude_sd_m=1.5)
    return LidarFrame(stamp_s, flat_road(), odom_from_vehicle=planar(x_m, 0.0, 0.0), gnss=fix, speed_mps=10.0)


def driven(vehicle: Vehicle, frames: int = 25) -> Step:
    step = None
    for number in range(frames):
        step = vehicle.step(frame_at(number * 1.0, number / 10))
    assert step is not None
    return step


@pytest.mark.parametrize("lost", [{"gnss": None}, {"odom_from_vehicle": None}])
def test_without_a_pose_obstacles_are_detected_but_nothing_is_said_or_shown(lost: dict[str, None]) -> None:
    link = HeldLink()
    step = Vehicle(CALIBRATION, link, pseudonym="car").step(replace(frame_at(0.0, 0.0), **lost))
    assert step.pose is None
    assert step.reason is not None
    assert len(step.detection.labels) == len(flat_road())
    assert step.alerts.hazards == ()
    assert not step.alerts.fresh
    assert link.heard_at == []
    assert link.reports == []


def test_from_a_stated_place_the_driver_is_warned_and_nothing_is_reported() -> None:
    known = feature(east_m=20.0)
    link = HeldLink(Appeared(position_seq=1, obstacle=known))
    stated = PoseFilter(stated=StatedPlace(ORIGIN, np.pi / 2))
    vehicle, totals = Vehicle(CALIBRATION, link, pseudonym="car", pose_filter=stated), Totals()
    shown = set()
    for number in range(45):
        step = vehicle.step(replace(frame_at(number * 1.0, number / 10), gnss=None))
        shown |= {hazard.obstacle_id for hazard in step.alerts.hazards}
        totals.add(step)
    end = vehicle.finish(step)
    assert shown == {known.id}
    assert (step.reason, end.reports, link.reports) == (ODOMETRY_ALONE, (), [])
    assert (totals.warned, totals.placed, totals.reports) == (1, 0, 0)


def test_an_obstacle_is_warned_of_once_though_the_place_is_lost_for_a_frame_now_and_then() -> None:
    link = HeldLink(Appeared(position_seq=1, obstacle=feature(east_m=30.0)))
    vehicle, totals = Vehicle(CALIBRATION, link, pseudonym="car"), Totals()
    for number in range(20):
        frame = frame_at(number * 0.5, number / 10)
        totals.add(vehicle.step(replace(frame, odom_from_vehicle=None) if number % 5 == 4 else frame))
    assert (totals.warned, totals.placed) == (1, 16)


def test_a_sound_road_brings_no_report() -> None:
    link = HeldLink()
    vehicle = Vehicle(CALIBRATION, link, pseudonym="car")
    end = vehicle.finish(driven(vehicle))
    assert (end.measured, end.reports, end.answers) == ((), (), ())
    assert link.reports == []


def test_the_server_is_asked_once_a_second_and_not_once_a_frame() -> None:
    link = HeldLink()
    driven(Vehicle(CALIBRATION, link, pseudonym="car"), frames=25)
    assert len(link.heard_at) == 3
    assert link.deliveries == 3


def test_a_known_obstacle_that_is_passed_is_inspected_once_also_when_nothing_was_detected() -> None:
    known = feature(east_m=20.0)
    link = HeldLink(Appeared(position_seq=1, obstacle=known))
    vehicle = Vehicle(CALIBRATION, link, pseudonym="car")
    vehicle.finish(driven(vehicle, frames=45))
    inspections = [i for report in link.reports for i in report.inspections]
    assert [i.obstacle_id for i in inspections] == [known.id]
    assert all(report.detections == () for report in link.reports)
    assert vehicle.waiting == 1


def test_without_a_server_the_drive_goes_on_and_the_link_says_nothing(tmp_path: Path) -> None:
    with ServerLink("http://127.0.0.1:9", None, tmp_path / "outbox.sqlite3") as link:
        step = driven(Vehicle(CALIBRATION, link, pseudonym="car"), frames=3)
        assert not link.connected
    assert step.pose is not None
    assert not step.alerts.fresh


@pytest.mark.parametrize(("x_m", "after_s", "begins_anew"), [(11.0, 0.1, False), (11.0, 2.0, True), (-40.0, 0.1, True)])
def test_after_a_gap_of_odometry_the_road_behind_is_forgotten(x_m: float, after_s: float, begins_anew: bool) -> None:
    vehicle = Vehicle(CALIBRATION, HeldLink(), pseudonym="car")
    driven(vehicle, frames=11)
    vehicle.step(frame_at(x_m, 1.0 + after_s))
    assert (len(vehicle._accumulator.keyframes) == 1) is begins_anew
