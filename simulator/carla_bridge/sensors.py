"""Sensors on a vehicle in CARLA: made from `sensors.json`, heard through queues, matched to the tick by their frame."""

from __future__ import annotations

import queue
import time
from contextlib import ExitStack
from dataclasses import dataclass

import carla

from simulator.carla_bridge.problem import CarlaBridgeError
from simulator.carla_bridge.session import destroy
from simulator.recording.handedness import carla_transform
from simulator.sensors.sensor_config import RigSensor, SensorRig

NOT_ATTRIBUTES = frozenset({"type", "role_name", "transform", "sensor_tick"})
"""Keys of a sensor's entry that are no attributes of the blueprint, or are seen to here (`Listener.is_due`)."""

DEFAULT_TICK_S = 0.05


@dataclass(frozen=True, slots=True)
class Listener:
    """A sensor that measures at every tick; of these every `every`-th is kept."""

    sensor: RigSensor
    actor: carla.Sensor
    arrived: queue.SimpleQueue[carla.SensorData]
    every: int

    def is_due(self, ticks: int) -> bool:
        """Whether the measurement after so many ticks is one to keep."""
        return ticks % self.every == 0

    def take(self, frame: int, within_s: float) -> carla.SensorData:
        """The measurement of a frame, past older ones; `CarlaBridgeError` when it does not come in time."""
        deadline = time.monotonic() + within_s
        while True:
            try:
                data = self.arrived.get(timeout=max(0.0, deadline - time.monotonic()))
            except queue.Empty:
                raise CarlaBridgeError(f"{self._label} sent nothing for frame {frame} within {within_s:g} s") from None
            if data.frame == frame:
                return data
            if data.frame > frame:
                raise CarlaBridgeError(f"{self._label} skipped frame {frame} and sent {data.frame}")

    @property
    def _label(self) -> str:
        return f"{self.sensor.name.type} {self.sensor.name.role!r}"


def tick_of(rig: SensorRig) -> float:
    """Seconds between ticks: one turn of the LiDAR, since CARLA sends what the LiDAR sweeps within a tick."""
    turns = {sensor.tick_s for sensor in rig.sensors if sensor.name.type.startswith("sensor.lidar")}
    if len(turns) > 1:
        raise CarlaBridgeError(f"LiDARs that turn at different rates cannot share CARLA's tick: {sorted(turns)} s")
    return turns.pop() if turns else DEFAULT_TICK_S


def attach(
    world: carla.World, vehicle: carla.Vehicle, rig: SensorRig, tick_s: float, undo: ExitStack
) -> list[Listener]:
    """The rig's sensors on a vehicle, already listening; `undo` stops and destroys them."""
    listeners = []
    for sensor in rig.sensors:
        at = carla_transform(sensor.vehicle_from_sensor)
        place = carla.Transform(
            carla.Location(at.x, at.y, at.z), carla.Rotation(pitch=at.pitch, yaw=at.yaw, roll=at.roll)
        )
        actor = world.try_spawn_actor(blueprint_of(world.get_blueprint_library(), sensor), place, attach_to=vehicle)
        if actor is None:
            raise CarlaBridgeError(f"CARLA did not make {sensor.name.type} {sensor.name.role!r}")
        undo.callback(destroy, actor)
        arrived: queue.SimpleQueue[carla.SensorData] = queue.SimpleQueue()
        undo.callback(actor.stop)
        actor.listen(arrived.put)
        listeners.append(Listener(sensor, actor, arrived, max(1, round(sensor.tick_s / tick_s))))
    return listeners


def blueprint_of(library: carla.BlueprintLibrary, sensor: RigSensor) -> carla.ActorBlueprint:
    """CARLA's blueprint with the attributes of the sensor's entry."""
    blueprint = library.find(sensor.name.type)
    attributes = {"role_name": sensor.name.role}
    attributes |= {key: str(value) for key, value in sensor.entry.items() if key not in NOT_ATTRIBUTES}
    for key, value in attributes.items():
        if not blueprint.has_attribute(key):
            raise CarlaBridgeError(f"{sensor.name.type} {sensor.name.role!r}: CARLA has no attribute {key}")
        blueprint.set_attribute(key, value)
    return blueprint
