"""One vehicle, read from one file: a frame comes in, and pose, obstacles, reports, alerts and picture come out.

source -> pose -> detect -> accumulate -> track -> hear -> watch -> report -> alert -> compose -> draw
"""

from __future__ import annotations

from dataclasses import dataclass
from uuid import UUID, uuid4

import numpy as np

from contract.observation import MAX_DETECTIONS, MAX_INSPECTIONS, ObservationReport, ReportResult
from contract.obstacle import ObstacleFeature
from detector.accumulator import Accumulator, accumulate, hits_around
from detector.inspection import PlaceVerdict, inspect
from detector.pipeline import detect
from detector.shape import measure
from detector.types import DetectedObstacle, DetectorInput, FrameDetection, PointClass
from vehicle_client import alerts, obstacle_map, pose, reporting, tracking, watching
from vehicle_client.alerts import Alerts
from vehicle_client.alignment import Alignment, align
from vehicle_client.ar.scene import Scene, compose
from vehicle_client.area import Heard
from vehicle_client.calibration import CameraCalibration, VehicleCalibration, curvature_of
from vehicle_client.frames import Matrix, apply
from vehicle_client.link import Link
from vehicle_client.obstacle_map import ObstacleMap
from vehicle_client.pose import Pose
from vehicle_client.sources.frame import LidarFrame
from vehicle_client.tracking import Track, Tracks

HEAR_EVERY_S = 1.0
"""How often the car says where it is, and sends again what was not answered: at 130 km/h the area moves by 36 m of its
600 m meanwhile, and a server that hangs costs one time-out a second of drive, not one a frame."""


@dataclass(frozen=True, slots=True)
class Answer:
    """A report and what the server decided about it."""

    report: ObservationReport
    result: ReportResult


@dataclass(frozen=True, slots=True)
class Step:
    """All that one frame brought: for the driver, for a recording, for whoever wants to understand a drive."""

    frame: LidarFrame
    pose: Pose | None
    detection: FrameDetection
    tracks: tuple[Track, ...]
    known: ObstacleMap
    alerts: Alerts
    told: tuple[Heard, ...]
    answers: tuple[Answer, ...]


class Vehicle:
    """A vehicle on a drive. The state is values; `step` folds one frame into them and talks to the server."""

    def __init__(
        self, calibration: VehicleCalibration, link: Link, *, pseudonym: str, known: ObstacleMap | None = None
    ) -> None:
        self._calibration = calibration
        self._link = link
        self._pseudonym = pseudonym
        self._pose_filter = pose.PoseFilter()
        self._accumulator = Accumulator()
        self._tracks = Tracks()
        self._known = ObstacleMap() if known is None else known
        self._watches = watching.NO_WATCHES
        self._sighted: frozenset[UUID] = frozenset()
        self._alerts = Alerts()
        self._heard_s = -np.inf
        self._waiting: dict[UUID, ObservationReport] = {}

    @property
    def waiting(self) -> int:
        """Reports of this drive that the server has not answered yet."""
        return len(self._waiting)

    def step(self, frame: LidarFrame) -> Step:
        """Take one frame in. Without a pose obstacles are detected, but nothing is reported or shown."""
        self._pose_filter, found = pose.update(self._pose_filter, frame)
        here = found.pose if found.reason is None else None
        sweep = detector_input(frame, self._calibration)
        detection = detect(sweep)
        if here is None or sweep.odom_from_sensor is None:
            return Step(frame, None, detection, (), self._known, Alerts(fresh=False), (), ())
        self._accumulator = accumulate(self._accumulator, sweep, detection)
        self._tracks = tracking.update(self._tracks, detection.obstacles, sweep.odom_from_sensor, frame.stamp_s)
        told, answered = self._exchange(here)
        self._watches = watching.watch(self._watches, self._known, here)
        answers = answered + self._report(here, at_end=False)
        self._alerts = alerts.choose(
            self._alerts, self._known, self._tracks.tracks, here, here.stamp_s, self._alignment(here)
        )
        return Step(frame, here, detection, self._tracks.tracks, self._known, self._alerts, told, answers)

    def finish(self, last: Step) -> tuple[Answer, ...]:
        """End the drive: report what was not yet passed by far enough, and hear the answers."""
        if last.pose is None:
            return ()
        answers: tuple[Answer, ...] = ()
        while any(self._due(last.pose, at_end=True)):
            answers += self._report(last.pose, at_end=True)
        return answers + self._deliver()

    def _exchange(self, here: Pose) -> tuple[tuple[Heard, ...], tuple[Answer, ...]]:
        """Hear the server and send it what waits, also from an earlier drive, once in a while."""
        if here.stamp_s - self._heard_s < HEAR_EVERY_S:
            return (), ()
        self._heard_s = here.stamp_s
        return self._hear(here), self._deliver()

    def _hear(self, here: Pose) -> tuple[Heard, ...]:
        told = tuple(self._link.hear(here.position))
        for message in told:
            self._known = obstacle_map.apply(self._known, message, here.stamp_s)
        self._known = obstacle_map.around(self._known, here.position, here.stamp_s)
        return told

    def _due(self, here: Pose, *, at_end: bool) -> tuple[list[Track], list[ObstacleFeature]]:
        """What is to be reported now, at most one report full; the rest waits for the next frame."""
        passed = reporting.due_tracks(self._tracks, here, at_end=at_end)
        inspected = watching.due(self._watches, here, at_end=at_end)
        return passed[:MAX_DETECTIONS], inspected[:MAX_INSPECTIONS]

    def _report(self, here: Pose, *, at_end: bool) -> tuple[Answer, ...]:
        passed, inspected = self._due(here, at_end=at_end)
        measured = [shape for t in passed if (shape := self._measure(t)) is not None]
        verdicts = self._inspect(inspected, here)
        self._tracks = self._tracks.marked_reported([t.track_id for t in passed])
        self._watches = watching.marked_inspected(self._watches, [f.id for f in inspected])
        if measured or verdicts:
            report = reporting.compose_report(
                uuid4(), here, measured, verdicts, pseudonym=self._pseudonym, sensor=self._calibration.sensor
            )
            self._waiting[report.report_id] = report
            self._link.put(report)
        return self._deliver() if measured or verdicts else ()

    def _deliver(self) -> tuple[Answer, ...]:
        results = self._link.deliver()
        self._sighted = self._sighted.union(
            d.obstacle_id for r in results for d in r.detections if d.obstacle_id is not None
        )
        return tuple(Answer(self._waiting.pop(r.report_id), r) for r in results if r.report_id in self._waiting)

    def _alignment(self, here: Pose) -> Alignment:
        return align([w.feature for w in self._watches.values()], self._tracks.tracks, here)

    def _measure(self, track: Track) -> DetectedObstacle | None:
        return measure(hits_around(self._accumulator, track.centre_odom_m[:2]), track.is_negative)

    def _inspect(self, features: list[ObstacleFeature], here: Pose) -> list[tuple[UUID, PlaceVerdict]]:
        alignment = self._alignment(here)
        verdicts = []
        for feature in features:
            place = reporting.known_place(feature, here, alignment)
            hits = hits_around(self._accumulator, place.centre_odom_m[:2], place.half_size_m)
            verdict = inspect(hits, place)
            verdicts.append((feature.id, reporting.weighed(verdict, sighted=feature.id in self._sighted)))
        return verdicts


def detector_input(frame: LidarFrame, calibration: VehicleCalibration) -> DetectorInput:
    """A frame as the detector takes it."""
    odom_from_vehicle = frame.odom_from_vehicle
    return DetectorInput(
        points_m=frame.points_m,
        sensor_height_m=calibration.sensor_height_m,
        curvature_per_m=curvature_of(frame.steering_rad),
        odom_from_sensor=None if odom_from_vehicle is None else odom_from_vehicle @ calibration.vehicle_from_sensor,
    )


def driver_scene(step: Step, calibration: VehicleCalibration, camera: CameraCalibration, note: str = "") -> Scene:
    """What the driver is shown at a step, in the pixels of a camera; `vehicle_client.ar.renderer.draw` paints it."""
    return compose(step.alerts, camera, _recognised_points(step, calibration), status_note=note)


def _recognised_points(step: Step, calibration: VehicleCalibration) -> Matrix:
    on_obstacle = step.detection.labels == PointClass.OBSTACLE
    return apply(calibration.vehicle_from_sensor, step.frame.points_m[on_obstacle])
