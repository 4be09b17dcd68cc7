"""A CARLA server in our hands for a while: in step with us, with our vehicles in it, and afterwards as it was."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import carla
import numpy as np

from simulator.carla_bridge.problem import CarlaBridgeError

LOG = logging.getLogger(__name__)

VEHICLE = "vehicle.tesla.model3"

ANSWER_WITHIN_S = 20.0
"""A server that loads a map's textures may take many seconds for its first answers."""


@dataclass(frozen=True, slots=True)
class Session:
    """A server that waits for `world.tick()`, and the traffic manager that drives for us."""

    client: carla.Client
    world: carla.World
    traffic_manager: carla.TrafficManager


def connect(host: str, port: int) -> carla.Client:
    """A client whose server answers and has the client's version."""
    client = carla.Client(host, port)
    client.set_timeout(ANSWER_WITHIN_S)
    try:
        server, ours = client.get_server_version(), client.get_client_version()
    except RuntimeError as error:
        raise CarlaBridgeError(f"no CARLA server answers at {host}:{port}; start CarlaUE4.sh there") from error
    if server != ours:
        raise CarlaBridgeError(f"the CARLA server has version {server}, the client {ours}; they must be the same")
    return client


@contextmanager
def synchronous(client: carla.Client, tick_s: float, seed: int, traffic_port: int) -> Iterator[Session]:
    """The server in synchronous mode with fixed steps; its own settings come back however the block ends."""
    world = client.get_world()
    before = world.get_settings()
    longest_s = before.max_substeps * before.max_substep_delta_time
    if before.substepping and tick_s > longest_s + 1e-9:
        raise CarlaBridgeError(f"CARLA's physics takes steps up to {longest_s} s, the sensors ask for {tick_s} s")
    with ExitStack() as undo:
        undo.callback(_apply, world, before)
        settings = world.get_settings()
        settings.synchronous_mode = True
        settings.fixed_delta_seconds = tick_s
        world.apply_settings(settings)
        manager = client.get_trafficmanager(traffic_port)
        undo.callback(manager.set_synchronous_mode, False)
        manager.set_synchronous_mode(True)
        manager.set_random_device_seed(seed)
        yield Session(client, world, manager)


def spawn_vehicles(session: Session, egos: int, seed: int, undo: ExitStack) -> list[carla.Vehicle]:
    """Vehicles under autopilot at spawn points that the seed chooses; `undo` destroys them."""
    points = session.world.get_map().get_spawn_points()
    order = np.random.default_rng(seed).permutation(len(points))
    library = session.world.get_blueprint_library()
    vehicles: list[carla.Vehicle] = []
    for index in order.tolist():
        if len(vehicles) == egos:
            break
        blueprint = library.find(VEHICLE)
        blueprint.set_attribute("role_name", f"ego{len(vehicles)}")
        vehicle = session.world.try_spawn_actor(blueprint, points[index])
        if vehicle is not None:
            undo.callback(destroy, vehicle)
            vehicles.append(vehicle)
            vehicle.set_autopilot(True, session.traffic_manager.get_port())
    if len(vehicles) < egos:
        raise CarlaBridgeError(f"the map has {len(points)} spawn points, {len(vehicles)} of them free: not {egos}")
    return vehicles


def destroy(actor: carla.Actor) -> None:
    """Remove an actor; one that is gone already is no reason to leave the others behind."""
    try:
        if not actor.destroy():
            LOG.warning("CARLA did not destroy actor %s", actor.id)
    except RuntimeError as error:
        LOG.warning("CARLA could not destroy actor %s: %s", actor.id, error)


def _apply(world: carla.World, settings: carla.WorldSettings) -> None:
    world.apply_settings(settings)
