"""A simulated drive as a vehicle's source: what the simulator measured, without what it knows."""

from __future__ import annotations

from collections.abc import Iterator

from simulator.camera import CameraModel
from simulator.drive import Drive, DrivePlan, DriveSample
from vehicle_client.calibration import CameraCalibration, VehicleCalibration
from vehicle_client.sources.frame import GnssFix, LidarFrame


class SimulatedSource:
    """Frames of one drive. `sample` is the moment of the last one, for pictures of the same world."""

    def __init__(self, drive: Drive) -> None:
        self._drive = drive
        self.sample: DriveSample | None = None

    def __len__(self) -> int:
        return len(self._drive)

    def __iter__(self) -> Iterator[LidarFrame]:
        for sample in self._drive:
            self.sample = sample
            yield frame_of(sample)


def frame_of(sample: DriveSample) -> LidarFrame:
    """The measurements of a moment; the exact poses and the labels stay behind."""
    fix = sample.gnss
    return LidarFrame(
        stamp_s=sample.stamp_s,
        points_m=sample.points_m,
        ring=sample.ring,
        image=sample.image,
        odom_from_vehicle=sample.odom_from_vehicle,
        gnss=GnssFix(fix.position, fix.altitude_m, fix.heading_rad, fix.sd_m, fix.altitude_sd_m),
        steering_rad=sample.steering_rad,
        speed_mps=sample.speed_mps,
    )


def calibration_of(plan: DrivePlan) -> VehicleCalibration:
    """Where the simulated car carries its LiDAR."""
    return VehicleCalibration(plan.vehicle_from_sensor, sensor="ray-cast-64")


def camera_calibration(model: CameraModel) -> CameraCalibration:
    """The simulated camera as the vehicle knows it."""
    return CameraCalibration(model.matrix, model.width_px, model.height_px, model.vehicle_from_camera)
