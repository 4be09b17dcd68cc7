"""Before a sensor waits: what a drive does in compiled loops has been done once."""

from __future__ import annotations

import subprocess
import sys

SEEN = """
import sys
import numpy as np
from numba.core.registry import CPUDispatcher

import vehicle_client.warming as warming
from tests.unit.vehicle_client import making
from vehicle_client.sensing.calibration import VehicleCalibration
from vehicle_client.drive import Vehicle
from vehicle_client.frames import rigid


def loaded():
    of_ours = [module for name, module in sys.modules.items() if name.startswith(("detector.", "vehicle_client."))]
    loops = [loop for module in of_ours for loop in vars(module).values() if isinstance(loop, CPUDispatcher)]
    return {loop.py_func.__qualname__: len(loop.signatures) for loop in loops}


warming.load_compiled()
before = loaded()
car = VehicleCalibration(rigid(np.eye(3), np.array([0.0, 0.0, 2.0])), "another")
vehicle = Vehicle(car, warming.NobodyLink(), pseudonym="another")
for index in range(12):
    last = vehicle.step(warming._sweep(index + 3))
vehicle.finish(last)
print(sorted(name for name, number in loaded().items() if number != before[name]))
assert sum(before.values()) > 40, before
"""


def test_a_drive_after_it_loads_and_compiles_nothing_more() -> None:
    done = subprocess.run([sys.executable, "-c", SEEN], capture_output=True, text=True, check=False)
    assert done.stdout == "[]\n", done.stderr
