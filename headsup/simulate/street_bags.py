"""Two cars on the demo's street, whose drives are ROS 2 bags."""

from __future__ import annotations

from headsup.demo.simulated import LIDAR_HEIGHT_M, SimulatedSource, calibration, drive_on
from simulator.streets.street import Street, first_light_street
from simulator.world import World

SPEED_MPS = 50 / 3.6
SEED = 1

STARTED_S = 1_780_000_000.0
"""Both begin at that moment, in May 2026: driven `--as-if-now`, each is moved to the present by itself."""

FIRST_WAY_M = (150.0, 304.0)
SECOND_WAY_M = (110.0, 180.0)
"""The second car's bag ends 38 m before the street's first obstacle: farther than the detector looks."""

CAR_TOML = f"""[lidar]
sensor = "{calibration().sensor}"
place_m = [0.0, 0.0, {LIDAR_HEIGHT_M}]
"""


def street() -> Street:
    """The street that both drive along: two potholes, a bump and a broken pallet."""
    return first_light_street(SEED)


def first_car(on: World) -> SimulatedSource:
    """The car that passes the obstacles, 11 s at ten sweeps a second; the same every time."""
    return SimulatedSource(drive_on(on, *FIRST_WAY_M, SPEED_MPS, SEED), STARTED_S)


def second_car(on: World) -> SimulatedSource:
    """The car that is still coming towards them, 5 s."""
    return SimulatedSource(drive_on(on, *SECOND_WAY_M, SPEED_MPS, SEED + 1), STARTED_S)
