"""A recording from a running CARLA server, read from top to bottom: in step, spawn, settle, tick and write.

CARLA's world is our frame `street` with y turned round; x points east.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import carla
import numpy as np
from numpy.typing import NDArray

from simulator.carla_bridge.measurements import map_origin, reading_of, street_from
from simulator.carla_bridge.problem import CarlaBridgeError
from simulator.carla_bridge.sensors import Listener, attach, tick_of
from simulator.carla_bridge.session import Session, spawn_vehicles, synchronous
from simulator.readings import EgoFrame
from simulator.recording.carla_layout import FULL_STEERING_DEG
from simulator.recording.header import RecordingHeader
from simulator.recording.writer import RecordingWriter
from simulator.sensors.sensor_config import SensorRig
from simulator.streets.street import GeoReference

SETTLE_S = 1.0
"""Vehicles are spawned above the road and drop onto it; a second is enough to come to rest."""


@dataclass(frozen=True, slots=True)
class RecordingPlan:
    """What to record: `start` is the moment of CARLA's time 0, `within_s` how long a measurement may take."""

    egos: int
    seconds: float
    seed: int
    rig: SensorRig
    mcap: bool = True
    start: datetime = datetime(2026, 1, 1, tzinfo=UTC)
    traffic_port: int = 8000
    within_s: float = 10.0


@dataclass(slots=True)
class _Ego:
    """A vehicle, its sensors, and where it was first."""

    vehicle: carla.Vehicle
    listeners: list[Listener]
    start: NDArray[np.float64] | None = None


def record(client: carla.Client, plan: RecordingPlan, folder: Path, on_tick: Callable[[], None] = lambda: None) -> int:
    """Write a recording of `plan.egos` vehicles under autopilot, and say how many ticks it has.

    However it ends, also by Ctrl-C, every actor made here is destroyed and the server's settings come back.
    """
    tick_s = tick_of(plan.rig)
    ticks = round(plan.seconds / tick_s)
    if not plan.rig.sensors or plan.egos < 1 or ticks < 1:
        raise CarlaBridgeError("a recording needs a vehicle, a sensor and at least one tick")
    with synchronous(client, tick_s, plan.seed, plan.traffic_port) as session, ExitStack() as undo:
        vehicles = spawn_vehicles(session, plan.egos, plan.seed, undo)
        for _ in range(round(SETTLE_S / tick_s)):
            session.world.tick()
        egos = [_Ego(v, attach(session.world, v, plan.rig, tick_s, undo)) for v in vehicles]
        carla_map = session.world.get_map()
        header = _header(plan, client, carla_map, tick_s)
        with RecordingWriter(folder, header, plan.egos, mcap=plan.mcap) as recording:
            for done in range(ticks):
                frames = _tick(session, egos, done, plan.within_s, carla_map, header.georeference)
                for ego, frame in enumerate(frames):
                    recording.write(ego, frame)
                on_tick()
    return ticks


def _header(plan: RecordingPlan, client: carla.Client, carla_map: carla.Map, tick_s: float) -> RecordingHeader:
    return RecordingHeader(
        made_by=f"CARLA {client.get_server_version()}, {carla_map.name}",
        seed=plan.seed,
        start=plan.start,
        tick_s=tick_s,
        georeference=map_origin(carla_map),
        enu_from_street=np.eye(4),
        sensors=plan.rig.entries,
    )


def _tick(
    session: Session, egos: list[_Ego], done: int, within_s: float, carla_map: carla.Map, origin: GeoReference
) -> list[EgoFrame]:
    """One step of the world, and what every vehicle's sensors say of it."""
    number = session.world.tick()
    time_s = session.world.get_snapshot().timestamp.elapsed_seconds
    frames = []
    for ego in egos:
        measured = [(listener, listener.take(number, within_s)) for listener in ego.listeners]
        due = [(listener.sensor, data) for listener, data in measured if listener.is_due(done)]
        pose = street_from(ego.vehicle.get_transform())
        if ego.start is None:
            ego.start = pose
        velocity = ego.vehicle.get_velocity()
        frames.append(
            EgoFrame(
                number=number,
                time_s=time_s,
                street_from_vehicle=pose,
                enu_from_vehicle=pose,
                odom_from_vehicle=np.linalg.inv(ego.start) @ pose,
                speed_mps=float(np.linalg.norm([velocity.x, velocity.y, velocity.z])),
                steering_rad=-float(np.radians(FULL_STEERING_DEG * ego.vehicle.get_control().steer)),
                readings=tuple(reading_of(sensor, data, carla_map, origin) for sensor, data in due),
            )
        )
    return frames
