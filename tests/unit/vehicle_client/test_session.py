"""What preparing a frame of a drive brings: the sweep is searched before or after its points are moved, as it must."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from detector.pipeline import detect
from tests.unit.vehicle_client.test_drive import CALIBRATION, frame_at
from vehicle_client.drive import detector_input
from vehicle_client.sensing.calibration_file import CarCalibration
from vehicle_client.sensing.preparation import Preparation
from vehicle_client.session import Preparing

CAR = CarCalibration(CALIBRATION)


@pytest.mark.parametrize("rolling", [False, True])
def test_the_detection_is_that_of_the_prepared_sweep(rolling: bool) -> None:
    preparation = Preparation(CAR)
    with Preparing(CAR, realtime=False) as preparing:
        for index in range(3):
            frame = frame_at(index * 1.4, 1_000.0 + index / 10)
            times = np.linspace(-0.1, 0.0, len(frame.points_m), dtype=np.float32) if rolling else None
            frame = replace(frame, point_time_s=times)
            prepared, known = preparing(frame)
            expected = preparation.prepared(frame)
            assert np.array_equal(prepared.points_m, expected.points_m)
            assert known.detection is not None
            alone = detect(detector_input(expected, CALIBRATION))
            assert np.array_equal(known.detection.labels, alone.labels)
            assert np.array_equal(known.detection.residual_m, alone.residual_m, equal_nan=True)
    assert np.array_equal(prepared.points_m, frame.points_m) is not rolling


def test_what_cannot_be_a_sweep_is_prepared_without_a_detection() -> None:
    frame = replace(frame_at(0.0, 1_000.0), points_m=np.zeros((3, 2), np.float32))
    with Preparing(CAR, realtime=False) as preparing:
        _, known = preparing(frame)
    assert known.detection is None
