"""A drive as it happened, into one MCAP file that Foxglove shows and `open_source` reads again.

with DriveRecorder(Path("drive.mcap"), calibration) as recorder:
    for frame in source:
        recorder.add(vehicle.step(frame), overlay_bgr)
"""

from __future__ import annotations

import itertools
import logging
import shutil
from pathlib import Path
from types import TracebackType

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from numpy.typing import NDArray
from pydantic_core import to_jsonable_python

from vehicle_client.drive import Step
from vehicle_client.recording import found_messages as found
from vehicle_client.recording import sensor_messages as sensors
from vehicle_client.recording.mcap_channels import McapChannels
from vehicle_client.sensing.calibration import VehicleCalibration
from vehicle_client.sources.frame import LidarFrame

LOG = logging.getLogger(__name__)

LEAST_FREE_BYTES = 1_000_000_000
"""Left on the disk: reports that wait for the network must still fit, and a full disk stops more than a recording."""


class RecordingError(ValueError):
    """A recording cannot be begun; the message says why."""


class DriveRecorder:
    """Writes steps of a drive, topics as in docs/sources.md. The file has its name once it is closed.

    Until then it is called `NAME.part`, and if the process is killed it can be read as far as chunks were written (some
    4 MB); the next recording of that name sets it aside. A disk that is nearly full, or fails, ends the recording with
    a warning and not the drive: `stopped` says why. `RecordingError` if the file is there already or cannot be made.
    """

    def __init__(
        self, path: Path, calibration: VehicleCalibration, *, least_free_bytes: int = LEAST_FREE_BYTES
    ) -> None:
        self._path, self._part = path, path.with_name(path.name + ".part")
        self._calibration, self._least_free_bytes = calibration, least_free_bytes
        self.stopped: str | None = None
        if path.exists():
            raise RecordingError(f"{path}: is there already; give a new name")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            _set_aside(self._part, path)
            self._stream = self._part.open("wb")
        except OSError as error:
            raise RecordingError(f"{path}: cannot be made: {error.strerror}") from error
        self._channels = McapChannels(self._stream, {"sensor": calibration.sensor})

    def __enter__(self) -> DriveRecorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def add(self, step: Step, overlay_bgr: NDArray[np.uint8] | None = None, measured: LidarFrame | None = None) -> None:
        """Write all that a frame brought, and the picture that the driver was shown, (H, W, 3) uint8 BGR.

        `measured` is the frame as the source gave it, before its points and stamps were prepared: so a drive of the
        recording is prepared in the same way, once. Without it the step's own frame is written.
        """
        if self.stopped is not None:
            return
        try:
            free_bytes = shutil.disk_usage(self._path.parent).free
            if free_bytes < self._least_free_bytes:
                self._stop(f"only {free_bytes / 1e9:.1f} GB are free")
                return
            self._put(step, overlay_bgr, step.frame if measured is None else measured)
            self._stream.flush()
        except OSError as error:
            self._stop(str(error.strerror or error))

    def close(self) -> None:
        """Finish the file and give it its name. What a failing disk did not take stays as `.part`."""
        if self._stream.closed:
            return
        try:
            self._channels.finish()
            self._stream.close()
            self._part.replace(self._path)
        except OSError as error:
            LOG.warning("%s: cannot be finished: %s; %s can be read as far as it goes", self._path, error, self._part)
            if self.stopped is None:
                self.stopped = f"cannot be finished: {error.strerror or error}; {self._part} has what was written"
            self._abandon()

    def _stop(self, reason: str) -> None:
        self.stopped = reason
        LOG.warning("%s: the recording ends here: %s", self._path, reason)
        self.close()

    def _abandon(self) -> None:
        try:
            self._stream.close()
        except OSError as error:
            LOG.warning("%s: %s", self._part, error)

    def _put(self, step: Step, overlay_bgr: NDArray[np.uint8] | None, frame: LidarFrame) -> None:
        now_ns = sensors.stamp_ns(frame.stamp_s)
        self._put_measured(frame, now_ns)
        self._put_transforms(step, now_ns)
        self._channels.put("/lidar", now_ns, sensors.point_cloud(frame, step.detection))
        if overlay_bgr is not None:
            self._channels.put("/overlay", now_ns, sensors.jpeg(overlay_bgr, now_ns, "camera"))
        if step.pose is not None:
            self._channels.put("/pose", now_ns, sensors.pose_fix(step.pose, now_ns))
        self._channels.put("/obstacles", now_ns, found.scene(now_ns, step.tracks, step.known, step.pose))
        for topic, title, value in (
            ("/state", "headsup.PoseState", found.pose_json(step.pose, step.reason)),
            ("/detections", "headsup.Detections", found.detections_json(step.detection, step.found)),
            ("/alerts", "headsup.Alerts", found.alerts_json(step.alerts)),
        ):
            self._channels.put_json(topic, now_ns, title, value)
        for report in step.reports:
            self._channels.put_json("/reports", now_ns, "headsup.ObservationReport", report.model_dump(mode="json"))
        for answer in step.answers:
            said = {"report": answer.report.model_dump(mode="json"), "result": answer.result.model_dump(mode="json")}
            self._channels.put_json("/answers", now_ns, "headsup.Answer", said)
        for heard in step.told:
            told = {"heard": type(heard).__name__.lower(), **to_jsonable_python(heard)}
            self._channels.put_json("/told", now_ns, "headsup.Heard", told)

    def _put_measured(self, frame: LidarFrame, now_ns: int) -> None:
        """What came with the sweep, each with its own stamp, but none after it: so it is joined to it again."""
        if frame.image is not None:
            taken_s = frame.stamp_s if frame.image_stamp_s is None else frame.image_stamp_s
            taken_ns = sensors.stamp_ns(taken_s)
            self._channels.put("/camera", now_ns, sensors.jpeg(frame.image, taken_ns, "camera"))
        for fix in frame.fixes:
            fixed_s = frame.stamp_s if fix.stamp_s is None else fix.stamp_s
            self._channels.put("/gnss", now_ns, sensors.location_fix(fix, sensors.stamp_ns(fixed_s)))
        for motion in frame.motions:
            said = {"speed_mps": motion.speed_mps, "yaw_rate_rps": motion.yaw_rate_rps}
            self._put_state(min(sensors.stamp_ns(motion.stamp_s), now_ns), said)
        steering = {"steering_rad": frame.steering_rad}
        if frame.odom_from_vehicle is not None:
            self._channels.put("/odometry", now_ns, sensors.odometry(frame.odom_from_vehicle, frame.speed_mps, now_ns))
        elif not frame.motions and frame.speed_mps is not None:
            steering["speed_mps"] = frame.speed_mps
        self._put_state(now_ns, steering)

    def _put_state(self, time_ns: int, said: dict[str, float | None] | dict[str, float]) -> None:
        known = {name: value for name, value in said.items() if value is not None}
        self._channels.put_json("/vehicle", time_ns, "headsup.VehicleState", known)

    def _put_transforms(self, step: Step, now_ns: int) -> None:
        transforms = [
            sensors.frame_transform(now_ns, "vehicle", "sensor", self._calibration.vehicle_from_sensor),
        ]
        if step.pose is not None:
            transforms.append(sensors.frame_transform(now_ns, "odom", "vehicle", step.pose.odom_from_vehicle))
            transforms.append(sensors.frame_transform(now_ns, "enu", "odom", step.pose.enu_from_odom))
        self._channels.put("/tf", now_ns, FrameTransforms(transforms=transforms))


def _set_aside(part: Path, path: Path) -> None:
    """Keep what a killed process left, under a name that is free."""
    if not part.is_file():
        return
    names = (path.with_name(f"{path.stem}.unfinished-{number}{path.suffix}") for number in itertools.count(1))
    free = next(name for name in names if not name.exists())
    part.rename(free)
    LOG.warning("%s: a recording that was not finished is kept as %s", path, free.name)
