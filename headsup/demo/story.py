"""The demo, read from one file: five drives on one street that changes between them, and a server that remembers.

1. ego1 sees two potholes, a bump and debris nobody knew: created.
2. ego2 is warned by the server long before its own LiDAR sees them, then sees them: kept.
3. A pothole has grown by a quarter; ego3 passes: updated.
4. It has been filled; ego4 and ego5 pass and do not find it: absent, removed.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import httpx

from contract.geometry import Kind
from contract.obstacle import ObstacleCollection
from headsup.demo.film import CAMERA, Film
from headsup.demo.pictures import Album
from headsup.demo.printing import Reporter
from headsup.demo.problem import DemoError
from headsup.demo.record import DriveRecord
from headsup.demo.report import write_report
from headsup.demo.server_process import ServerProcess
from headsup.demo.simulated import SimulatedSource, calibration, camera_calibration, drive_on, passers_by
from headsup.demo.summary import Summary, write_summary
from simulator.readings import EgoFrame
from simulator.samples.scan import find_scans, load_scan
from simulator.scene.mover import Mover
from simulator.shapes.relief import Relief
from simulator.streets.street import Street, fill, first_light_street, grow
from simulator.world import World
from vehicle_client.drive import Step, Vehicle, driver_scene
from vehicle_client.link.server_link import ServerLink
from vehicle_client.sensing.calibration_file import CarCalibration
from vehicle_client.sensing.preparation import Preparation

SPEED_MPS = 50 / 3.6
"""The speed limit of a town."""

APPROACH_FROM_M, LONG_APPROACH_FROM_M, END_M = 150.0, 40.0, 304.0
"""ego2 comes from far, to be warned; the others begin 65 m before the first obstacle."""

GROWTH = 1.25
BACK_S = 6 * 3600.0
HOUR_S = 3600.0
"""The drives lie an hour apart in the last six hours: the server refuses observations from the future."""


@dataclass(frozen=True, slots=True)
class Act:
    """One drive: which car, on which street, from where, with what in the windshield."""

    car: str
    street: Street
    start_x_m: float
    hour: int
    filmed: bool = False


def acts(street: Street) -> list[Act]:
    """The five drives. The pothole that changes is the street's first."""
    hole = next(o.obstacle_id for o in street.obstacles if o.kind is Kind.POTHOLE)
    grown, filled = grow(street, hole, GROWTH), fill(street, hole)
    return [
        Act("ego1", street, APPROACH_FROM_M, 0),
        Act("ego2", street, LONG_APPROACH_FROM_M, 1, filmed=True),
        Act("ego3", grown, APPROACH_FROM_M, 2),
        Act("ego4", filled, APPROACH_FROM_M, 3),
        Act("ego5", filled, APPROACH_FROM_M, 4),
    ]


class Worlds:
    """The world of the latest street, and who passes by in every act: acts on the same street share it."""

    def __init__(self, movers: tuple[Mover, ...]) -> None:
        self._movers = movers
        self._world: World | None = None

    def of(self, street: Street) -> World:
        """The world of a street."""
        if self._world is None or self._world.street is not street:
            self._world = World(street, self._movers)
        return self._world


@dataclass(frozen=True, slots=True)
class Stage:
    """What every drive uses."""

    server: ServerProcess
    worlds: Worlds
    album: Album
    film: Film | None
    reporter: Reporter
    folder: Path


def tell(out: Path, data: Path | None, seed: int, *, with_video: bool) -> Summary:
    """Run the demo and write its folder. Raises DemoError, ScanError or OSError with what to do."""
    scans = _scans(data) if data is not None else ()
    out.mkdir(parents=True, exist_ok=True)
    street = first_light_street(seed, scans)
    plan, movers = acts(street), passers_by(street, seed)
    film_path = out / "ego2.mp4" if with_video else None
    (out / "ego2.mp4").unlink(missing_ok=True)
    reporter, album = Reporter([*(act.car for act in plan), *(["film"] if with_video else [])]), Album(out)
    with (
        tempfile.TemporaryDirectory(prefix="headsup-demo-") as folder,
        reporter,
        ServerProcess(Path(folder), out / "server.log") as server,
        Film(film_path, street, movers) if film_path is not None else nullcontext() as film,
    ):
        keys = {act.car: server.create_key(act.car) for act in plan}
        server.start()
        stage = Stage(server, Worlds(movers), album, film, reporter, Path(folder))
        records = [_drive(act, stage, keys[act.car], seed + number) for number, act in enumerate(plan)]
        obstacles = _fetch_obstacles(server, street, keys[plan[0].car])
        if film is not None:
            film.finish(reporter)
    (out / "obstacles.geojson").write_text(obstacles.model_dump_json(indent=1, exclude_none=True))
    summary = write_summary(out / "summary.json", street, records, seed=seed, scans=data is not None)
    write_report(out / "report.html", summary, records, obstacles, album, film_path=film_path)
    reporter.show(summary, out)
    if untold := summary.untold():
        raise DemoError(f"the story is not complete, no {' and no '.join(untold)}; the report shows what happened")
    return summary


def _scans(data: Path) -> Sequence[Relief]:
    return [load_scan(path) for path in find_scans(data / "potholes")]


def _drive(act: Act, stage: Stage, key: str, seed: int) -> DriveRecord:
    started_s = math.floor(time.time() - BACK_S + act.hour * HOUR_S)
    world = stage.worlds.of(act.street)
    source = SimulatedSource(drive_on(world, act.start_x_m, END_M, SPEED_MPS, seed), started_s)
    record = DriveRecord(act.car, act.street, calibration(), SPEED_MPS)
    with ServerLink(stage.server.url, key, stage.folder / f"{act.car}.sqlite3") as link:
        vehicle = Vehicle(record.calibration, link, pseudonym=act.car)
        preparation = Preparation(CarCalibration(record.calibration))
        step: Step | None = None
        for frame in stage.reporter.track(source, act.car):
            stage.server.ensure_alive()
            step = vehicle.step(preparation.prepared(frame))
            _keep(act, stage, record, step, source.moment, world)
        if step is not None:
            record.note_answers(vehicle.finish(step).answers)
    stage.server.ensure_alive()
    if vehicle.waiting:
        raise DemoError(f"the server left {vehicle.waiting} report(s) of {act.car} unanswered; its log says why")
    return record


def _keep(act: Act, stage: Stage, record: DriveRecord, step: Step, moment: EgoFrame | None, world: World) -> None:
    if moment is None:
        return
    record.note(step, float(moment.street_from_vehicle[0, 3]))
    stage.album.consider(act.car, step, record.calibration, world, moment)
    if act.filmed and stage.film is not None:
        camera = camera_calibration(CAMERA)
        stage.film.add(
            moment.street_from_vehicle, moment.time_s, driver_scene(step, record.calibration, camera, act.car)
        )


def _fetch_obstacles(server: ServerProcess, street: Street, key: str) -> ObstacleCollection:
    middle = street.position_of(street.obstacles[1].obstacle_id)
    query = {"lat": middle.latitude_deg, "lon": middle.longitude_deg, "radius_m": 500}
    try:
        response = httpx.get(
            f"{server.url}/v1/obstacles", params=query, headers={"Authorization": f"Bearer {key}"}, timeout=10
        )
        response.raise_for_status()
    except httpx.HTTPError as error:
        server.ensure_alive()
        raise DemoError(f"the server does not list its obstacles: {error}") from error
    return ObstacleCollection.model_validate_json(response.content)
