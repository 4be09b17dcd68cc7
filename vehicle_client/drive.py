"""One vehicle, read from one file: a frame comes in, and pose, obstacles, reports, alerts and picture come out.

source -> prepare -> detect -> pose -> accumulate -> track -> hear -> watch -> alert -> compose -> draw, and then
measure -> report
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from uuid import UUID, uuid4

import numpy as np

from contract.observation import MAX_DETECTIONS, MAX_INSPECTIONS, ObservationReport, ReportResult
from contract.obstacle import ObstacleFeature
from detector.passes.accumulator import Accumulator, accumulate, hits_around
from detector.passes.inspection import PlaceVerdict, inspect
from detector.passes.over_frames import detect_over_frames
from detector.passes.shape import measure
from detector.pipeline import detect
from detector.types import DetectedObstacle, DetectorInput, FrameDetection, PointClass
from vehicle_client import alerts, moments, obstacle_map, reporting, tracking, watching
from vehicle_client.alerts import Alerts
from vehicle_client.alignment import UNALIGNED, Alignment, align
from vehicle_client.ar.scene import Scene, compose
from vehicle_client.area import Heard
from vehicle_client.frames import Matrix, Vector, apply, inverse
from vehicle_client.link.server_link import Link
from vehicle_client.moments import Due
from vehicle_client.obstacle_map import ObstacleMap
from vehicle_client.positioning import pose
from vehicle_client.positioning.odometry_history import ODOMETRY_GAP_S, has_begun_anew
from vehicle_client.positioning.pose import Pose, PoseFilter
from vehicle_client.sensing.calibration import CameraCalibration, VehicleCalibration, curvature_of
from vehicle_client.sources.frame import LidarFrame
from vehicle_client.tracking import Track, Tracks

MOST_WAITING = 1_000
"""Reports of which the drive remembers what they said until they are answered: without network for hours they are in
the outbox all the same, and answered to nobody here."""

TOGETHER_EVERY_S = 0.09
"""The last ten sweeps are searched together ten times a second: of 30 sweeps a second each third one adds as much as
one of ten, and the search takes half of a frame's time."""

HEAR_EVERY_S = 1.0
"""How often the car says where it is, and sends again what was not answered: at 130 km/h the area moves by 36 m of its
600 m meanwhile, and a server that hangs costs one time-out a second of drive, not one a frame."""


@dataclass(frozen=True, slots=True)
class Answer:
    """A report and what the server decided about it."""

    report: ObservationReport
    result: ReportResult


@dataclass(frozen=True, slots=True)
class Measured:
    """An obstacle in `odom` as it was measured when its moment had come, and whether that went into a report."""

    due: Due
    obstacle: DetectedObstacle
    is_told: bool


@dataclass(frozen=True, slots=True)
class Step:
    """All that one frame brought: for the driver, for a recording, for whoever wants to understand a drive.

    `reason` says why nothing is reported, and without a pose why nothing is shown; None when both are. `detection` is
    of the sweep alone, `found` what the last sweeps show together, in `sensor`.
    """

    frame: LidarFrame
    pose: Pose | None
    reason: str | None
    detection: FrameDetection
    found: tuple[DetectedObstacle, ...]
    tracks: tuple[Track, ...]
    measured: tuple[Measured, ...]
    known: ObstacleMap
    alerts: Alerts
    told: tuple[Heard, ...] = ()
    reports: tuple[ObservationReport, ...] = ()
    answers: tuple[Answer, ...] = ()

    @property
    def reported_pose(self) -> Pose | None:
        """The pose if it may be told, too: one that somebody has only stated may not."""
        return self.pose if self.reason is None else None


class Vehicle:
    """A vehicle on a drive. The state is values; `see` folds one frame into them, `tell` talks of it to the server."""

    def __init__(
        self,
        calibration: VehicleCalibration,
        link: Link,
        *,
        pseudonym: str,
        known: ObstacleMap | None = None,
        pose_filter: PoseFilter | None = None,
    ) -> None:
        self._calibration = calibration
        self._link = link
        self._pseudonym = pseudonym
        self._pose_filter = pose_filter or PoseFilter()
        self._accumulator = Accumulator()
        self._tracks = Tracks()
        self._known = known or ObstacleMap()
        self._watches = watching.NO_WATCHES
        self._sighted: frozenset[UUID] = frozenset()
        self._alerts = Alerts()
        self._heard_s = -np.inf
        self._together_s = -np.inf
        self._odometry_before: tuple[float, Vector] = (-np.inf, np.zeros(3))
        self._waiting: OrderedDict[UUID, ObservationReport] = OrderedDict()

    @property
    def waiting(self) -> int:
        """Reports of this drive that the server has not answered yet, of the last `MOST_WAITING`."""
        return len(self._waiting)

    @property
    def known(self) -> ObstacleMap:
        """What the server said, to be kept for the next drive."""
        return self._known

    def step(self, frame: LidarFrame, detection: FrameDetection | None = None) -> Step:
        """Take one frame in: `see`, then `tell`."""
        return self.tell(self.see(frame, detection))

    def see(self, frame: LidarFrame, detection: FrameDetection | None = None) -> Step:
        """What the driver is to be shown at a frame, before anything is measured, which takes as long as a sweep.

        Without a pose obstacles are found, but nothing is shown. `detection` is what `detect` found in it, if somebody
        has asked already. Raises `DetectorError` for points that cannot be a sweep in metres; the state is then as
        before.
        """
        sweep = detector_input(frame, self._calibration)
        if detection is None:
            detection = detect(sweep)
        self._pose_filter, placed = pose.update(self._pose_filter, frame)
        here = placed.pose
        found = self._found(sweep, detection, frame.stamp_s)
        if here is None:
            tracks, shown = self._tracks.tracks, Alerts(fresh=False)
            return Step(frame, None, placed.reason, detection, found, tracks, (), self._known, shown)
        told, answered = self._exchange(here)
        self._watches = watching.watch(self._watches, self._known, here, self._sighted)
        alignment = self._alignment(here)
        self._alerts = alerts.choose(self._alerts, self._known, self._tracks.tracks, here, here.stamp_s, alignment)
        tracks, shown = self._tracks.tracks, self._alerts
        return Step(frame, here, placed.reason, detection, found, tracks, (), self._known, shown, told, (), answered)

    def tell(self, seen: Step) -> Step:
        """The step with what is measured and reported at it; `seen` is the latest that `see` gave.

        Without a pose that may be told obstacles are measured, but nothing is reported.
        """
        sweep, here = detector_input(seen.frame, self._calibration), seen.reported_pose
        alignment = UNALIGNED if here is None else self._alignment(here)
        measured = self._measured(here, sweep, alignment, at_end=False)
        reports = () if here is None else self._reports(here, alignment, measured, at_end=False)
        answers = seen.answers + (self._deliver() if reports else ())
        return replace(seen, tracks=self._tracks.tracks, measured=measured, reports=reports, answers=answers)

    def finish(self, last: Step) -> Step:
        """End the drive: measure and report what was not yet passed by far enough, and hear the answers."""
        sweep, here = detector_input(last.frame, self._calibration), last.reported_pose
        alignment = UNALIGNED if here is None else self._alignment(here)
        measured: tuple[Measured, ...] = ()
        reports: tuple[ObservationReport, ...] = ()
        while True:
            more = self._measured(here, sweep, alignment, at_end=True)
            put = () if here is None else self._reports(here, alignment, more, at_end=True)
            if not more and not put:
                break
            measured, reports = measured + more, reports + put
        answers = self._deliver()
        return replace(last, measured=measured, reports=reports, answers=answers, told=())

    def _found(self, sweep: DetectorInput, detection: FrameDetection, stamp_s: float) -> tuple[DetectedObstacle, ...]:
        """What the last sweeps show together, taken into the tracks.

        Without odometry, while the car stands, and soon after the last time what this one shows: the same look again
        makes nothing surer.
        """
        if sweep.odom_from_sensor is None:
            return detection.obstacles
        self._begin_anew_after_a_gap(sweep.odom_from_sensor, stamp_s)
        before, self._accumulator = self._accumulator, accumulate(self._accumulator, sweep, detection)
        if self._accumulator is before or 0 <= stamp_s - self._together_s < TOGETHER_EVERY_S:
            return detection.obstacles
        self._together_s = stamp_s
        if detection.corridor is None:
            # Where there is no road in sight, nothing is searched.
            return ()
        found = detect_over_frames(self._accumulator, sweep, detection)
        self._tracks = tracking.update(self._tracks, found, sweep.odom_from_sensor, stamp_s)
        return found

    def _begin_anew_after_a_gap(self, odom_from_sensor: Matrix, stamp_s: float) -> None:
        """Forget the road behind when odometry has: its frame is another one then."""
        before_s, before_m = self._odometry_before
        elapsed_s, moved_m = stamp_s - before_s, float(np.linalg.norm(odom_from_sensor[:3, 3] - before_m))
        if not 0 <= elapsed_s <= ODOMETRY_GAP_S or has_begun_anew(moved_m, elapsed_s):
            self._accumulator, self._tracks = Accumulator(), Tracks(next_id=self._tracks.next_id)
        self._odometry_before = stamp_s, odom_from_sensor[:3, 3]

    def _exchange(self, here: Pose) -> tuple[tuple[Heard, ...], tuple[Answer, ...]]:
        """Hear the server and send it what waits, also from an earlier drive, once in a while."""
        if here.stamp_s - self._heard_s < HEAR_EVERY_S:
            return (), ()
        self._heard_s = here.stamp_s
        # First the answers: what this pass has created is then known as its own when the server tells of it.
        answers = self._deliver()
        told = tuple(self._link.hear(here.position))
        for message in told:
            self._known = obstacle_map.apply(self._known, message, here.stamp_s)
        self._known = obstacle_map.around(self._known, here.position, here.stamp_s)
        self._sighted = frozenset(i for i in self._sighted if i in self._known.obstacles)
        return told, answers

    def _measured(
        self, here: Pose | None, sweep: DetectorInput, alignment: Alignment, *, at_end: bool
    ) -> tuple[Measured, ...]:
        """The obstacles whose moment has come, at most one report full; the rest waits for the next frame."""
        if sweep.odom_from_sensor is None:
            return ()
        odom_from_vehicle = sweep.odom_from_sensor @ inverse(self._calibration.vehicle_from_sensor)
        known = self._known_tracks(here, alignment)
        comes = moments.due(self._tracks.tracks, known, odom_from_vehicle, is_placed=here is not None, at_end=at_end)
        measured = []
        for due in comes[:MAX_DETECTIONS]:
            hits = hits_around(self._accumulator, due.track.centre_odom_m[:2])
            obstacle = measure(hits, due.track.is_negative)
            is_told = here is not None and obstacle is not None and moments.is_to_be_told(due, obstacle)
            self._tracks = self._tracks.with_track(moments.after(due, obstacle if is_told else None))
            if obstacle is not None:
                measured.append(Measured(due, obstacle, is_told))
        return tuple(measured)

    def _known_tracks(self, here: Pose | None, alignment: Alignment) -> frozenset[int]:
        if here is None:
            return frozenset()
        watched = [w.feature for w in self._watches.values()]
        return moments.known_tracks(self._tracks.tracks, watched, here, alignment)

    def _reports(
        self, here: Pose, alignment: Alignment, measured: Sequence[Measured], *, at_end: bool
    ) -> tuple[ObservationReport, ...]:
        """Put what is to be told of obstacles and known places into the outbox, as one report."""
        inspected = watching.due(self._watches, here, at_end=at_end)[:MAX_INSPECTIONS]
        verdicts = self._inspect(inspected, here, alignment)
        self._watches = watching.marked_inspected(self._watches, [f.id for f in inspected])
        told = [m.obstacle for m in measured if m.is_told]
        if not told and not verdicts:
            return ()
        report = reporting.compose_report(
            uuid4(), here, told, verdicts, pseudonym=self._pseudonym, sensor=self._calibration.sensor
        )
        if not report.detections and not report.inspections:
            return ()
        self._waiting[report.report_id] = report
        if len(self._waiting) > MOST_WAITING:
            self._waiting.popitem(last=False)
        self._link.put(report)
        return (report,)

    def _deliver(self) -> tuple[Answer, ...]:
        results = self._link.deliver()
        self._sighted = self._sighted.union(
            d.obstacle_id for r in results for d in r.detections if d.obstacle_id is not None
        )
        return tuple(Answer(self._waiting.pop(r.report_id), r) for r in results if r.report_id in self._waiting)

    def _alignment(self, here: Pose) -> Alignment:
        return align([w.feature for w in self._watches.values()], self._tracks.tracks, here)

    def _inspect(
        self, features: list[ObstacleFeature], here: Pose, alignment: Alignment
    ) -> list[tuple[UUID, PlaceVerdict]]:
        verdicts = []
        for feature in features:
            place = reporting.known_place(feature, here, alignment)
            hits = hits_around(self._accumulator, place.centre_odom_m[:2], place.half_size_m)
            verdict = inspect(hits, place)
            verdicts.append((feature.id, reporting.weighed(verdict, sighted=feature.id in self._sighted)))
        return verdicts


def detector_input(frame: LidarFrame, calibration: VehicleCalibration) -> DetectorInput:
    """A frame as the detector takes it. Odometry that is not finite counts as none."""
    odom_from_vehicle = frame.odom_from_vehicle
    if odom_from_vehicle is not None and not np.isfinite(odom_from_vehicle).all():
        odom_from_vehicle = None
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
