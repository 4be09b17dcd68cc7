"""A drive that meets what a year brings: a source that fails, a fault in a frame, a server that is away."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from detector.types import FrameDetection
from headsup.cli import app
from headsup.driving import Asked, Outcome, run
from tests.integration.serving import served
from tests.integration.street_bags import StreetBags, make_bags
from tests.unit.vehicle_client.test_drive import CALIBRATION, HeldLink, flat_road, frame_at
from vehicle_client.drive import Step, Vehicle
from vehicle_client.faults import MOST_IN_A_ROW
from vehicle_client.pacing import Paced
from vehicle_client.sensing.calibration_file import CarCalibration
from vehicle_client.session import Known, Preparing, drive_along
from vehicle_client.sources.frame import LidarFrame, SourceError
from vehicle_client.sources.live_sender import LiveSender, TcpSending
from vehicle_client.sources.live_source import CLOCK_WENT_BACK
from vehicle_client.totals import Totals

SPARSE_M = flat_road(spacing_m=0.5)

NOBODY = "http://127.0.0.1:9"

CAR = CarCalibration(CALIBRATION)


class FailingVehicle(Vehicle):
    """The real one, with a fault of the program in the frames of some numbers."""

    def __init__(self, *failing: int) -> None:
        super().__init__(CALIBRATION, HeldLink(), pseudonym="test")
        self._failing, self._number = failing, -1

    def see(self, frame: LidarFrame, detection: FrameDetection | None = None) -> Step:
        self._number += 1
        if self._number in self._failing:
            raise ZeroDivisionError(f"frame {self._number}")
        return super().see(frame, detection)


def frames(number: int, *, broken_off: str | None = None) -> Iterator[LidarFrame]:
    for index in range(number):
        yield frame_at(index * 1.0, 1_000.0 + index / 10)
    if broken_off is not None:
        raise SourceError(broken_off)


def driven(source: Iterator[LidarFrame], vehicle: Vehicle) -> tuple[Totals, Step | None]:
    totals = Totals()
    with Paced[Known](source, Preparing(CAR, realtime=False), realtime=False, is_recorded=True) as paced:
        last = drive_along(paced, vehicle, totals, ())
    return totals, last


def test_a_source_that_fails_ends_the_drive_in_order_and_says_why() -> None:
    totals, last = driven(frames(5, broken_off="the sensor's clock was set back"), FailingVehicle())
    assert last is not None
    assert (totals.frames, totals.broken_off) == (5, "the sensor's clock was set back")


def test_faults_in_single_frames_are_counted_and_logged_once_a_kind_with_their_trace(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with caplog.at_level(logging.ERROR):
        totals, last = driven(frames(20), FailingVehicle(3, 4, 11))
    assert (totals.frames, totals.faults) == (17, 3)
    assert last is not None
    (said,) = caplog.records
    assert "frame 3" in said.getMessage()
    assert said.exc_info is not None


def test_a_program_that_fails_in_every_frame_does_not_go_on_for_a_year() -> None:
    with pytest.raises(ZeroDivisionError):
        driven(frames(MOST_IN_A_ROW + 5), FailingVehicle(*range(3, 100)))


class FailingToTell(FailingVehicle):
    """Sees each frame, and fails to measure in the third."""

    def tell(self, seen: Step) -> Step:
        if self._number == 2:
            raise ZeroDivisionError("measured")
        return super().tell(seen)


def test_the_driver_is_shown_each_frame_before_it_is_measured() -> None:
    seen: list[Step] = []
    told: list[Step] = []
    totals = Totals()
    preparing = Preparing(CAR, realtime=False)
    with Paced[Known](frames(5), preparing, realtime=False, is_recorded=True) as paced:
        shows = [lambda step, _: told.append(step)], [lambda step, _: seen.append(step)]
        drive_along(paced, FailingToTell(), totals, *shows)
    assert [step.frame.stamp_s for step in seen] == [1_000.0 + index / 10 for index in range(5)]
    assert [step.frame.stamp_s for step in told] == [step.frame.stamp_s for step in seen if step is not seen[2]]
    assert all(step.alerts in [s.alerts for s in seen] for step in told)
    assert (totals.frames, totals.faults, int(totals.latency.counts.sum())) == (4, 1, 5)


def test_a_car_without_satellites_has_one_reason_however_long_it_stands() -> None:
    def source() -> Iterator[LidarFrame]:
        for index in range(400):
            frame = frame_at(0.0, 1_000.0 + index / 4)
            yield replace(frame, points_m=SPARSE_M, gnss=frame.gnss if index < 5 else None)

    totals, _ = driven(source(), FailingVehicle())
    assert set(totals.reasons) == {"the last satellite fix is N s old"}
    assert totals.reasons.total() == totals.frames - totals.placed > 20


def test_a_frame_that_is_no_sweep_is_left_out_and_is_no_fault() -> None:
    def source() -> Iterator[LidarFrame]:
        for frame in frames(6):
            yield replace(frame, points_m=np.zeros((3, 2), np.float32)) if frame.stamp_s == 1_000.2 else frame

    totals, _ = driven(source(), FailingVehicle())
    assert (totals.frames, totals.unusable, totals.faults) == (5, 1, 0)


def test_a_sensor_whose_clock_is_set_back_ends_the_command_with_its_summary_and_exit_code_1() -> None:
    with closing(TcpSending("127.0.0.1", 0)) as sending:

        def send() -> None:
            while not sending.vehicles:
                time.sleep(0.01)
            sender = LiveSender(sending)
            for stamp_s in [*range(5), *range(-CLOCK_WENT_BACK, 0)]:
                sender.send(replace(frame_at(0.0, 1_780_000_000.0 + stamp_s / 10), points_m=SPARSE_M))
                time.sleep(0.005)

        sensor = threading.Thread(target=send)
        sensor.start()
        done = CliRunner().invoke(app, ["drive", f"tcp://127.0.0.1:{sending.port}", "--sensor-height", "2.4"])
        sensor.join()
    assert done.exit_code == 1
    assert "frames" in done.stdout
    assert "headsup drive: the drive broke off: " in done.stderr
    assert "clock went back" in done.stderr


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> StreetBags:
    return make_bags(tmp_path_factory.mktemp("bags"))


def drive(bag: Path, server: str, state: Path) -> Outcome:
    return run(Asked(source=str(bag), sensor_height_m=2.4, server=server, state=state, as_if_now=True))


def test_what_was_found_while_the_server_was_away_arrives_with_the_next_drive_and_warns_without_network(
    bags: StreetBags, tmp_path: Path
) -> None:
    with served(tmp_path / "headsup.sqlite3") as server:
        away = drive(bags.over_the_first, NOBODY, tmp_path / "car")
        assert away.link is not None
        assert away.totals.reports == away.link.waiting > 0
        back = drive(bags.next, server.address, tmp_path / "car")
        assert back.link is not None
        assert (back.totals.reports, back.link.waiting) == (0, 0)
        assert back.link.fates == {"accepted": away.totals.reports}
        with server.client() as client:
            position = bags.street.position_of(bags.street.obstacles[0].obstacle_id)
            where = {"lat": position.latitude_deg, "lon": position.longitude_deg, "radius_m": 10}
            assert len(client.get("/v1/obstacles", params=where).json()["features"]) == 1
    alone = drive(bags.next, NOBODY, tmp_path / "car")
    assert alone.totals.detections == 0
    assert alone.totals.warned == back.totals.warned > 0
