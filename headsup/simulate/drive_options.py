"""The options that every command shares which makes drives: one list of them, and what they mean."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import StrEnum
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

if TYPE_CHECKING:
    from contract.geometry import LatLon
    from simulator.maps.map_street import MapFile
    from simulator.record import RecordingPlan
    from simulator.streets.world_plan import WorldPlan


class RoadClass(StrEnum):
    """Road classes of ISO 8608 as options."""

    A = "A"
    B = "B"
    C = "C"


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveOptions:
    """What is asked of each drive; with a seed it makes a plan."""

    egos: Annotated[int, typer.Option("--egos", min=1, max=8, help="Recording vehicles.")] = 2
    seconds: Annotated[float, typer.Option("--seconds", min=0.1, max=300.0, help="Recorded by each vehicle.")] = 20.0
    sensors: Annotated[
        str, typer.Option("--sensors", help="A sensors.json, or a built-in rig: paper, hdl64, hdl32.")
    ] = "paper"
    images: Annotated[
        bool, typer.Option("--images/--no-images", help="Cameras take most of the time; LiDAR alone is fast.")
    ] = True
    mcap: Annotated[bool, typer.Option("--mcap/--no-mcap", help="An MCAP file per vehicle beside CARLA's layout.")] = (
        True
    )
    traffic: Annotated[bool, typer.Option("--traffic/--no-traffic", help="Other cars and pedestrians.")] = True
    changes: Annotated[
        bool,
        typer.Option("--changes/--no-changes", help="Obstacles appear, grow or go between two vehicles' passes."),
    ] = True
    roughness: Annotated[
        RoadClass | None, typer.Option("--roughness", help="Road class of ISO 8608; by default from the seed.")
    ] = None
    data: Annotated[
        Path | None, typer.Option("--data", help="Folder with potholes/*.ply: real scans as the street's potholes.")
    ] = None

    map_file: Annotated[
        Path | None,
        typer.Option("--map", help="An OpenDRIVE file (.xodr): its roads and lanes instead of a street from the seed."),
    ] = None
    origin: Annotated[
        str | None,
        typer.Option("--origin", metavar="LAT,LON", help="Where the map's x = y = 0 lies, if the map does not say it."),
    ] = None

    def planner(self) -> Callable[[int], RecordingPlan]:
        """The plan of each seed; files are read once.

        ScanError, SensorConfigError, OpenDriveError and OSError say what is wrong.
        """
        from simulator.record import RecordingPlan
        from simulator.scenario import ScenarioPlan

        world, sensors, map_file = self._world(), self._sensors(), self._map()

        def plan(seed: int) -> RecordingPlan:
            asked = ScenarioPlan(
                seed,
                self.egos,
                self.seconds,
                traffic=self.traffic,
                changes=self.changes,
                world=world,
                map_file=map_file,
            )
            return RecordingPlan(asked, sensors, mcap=self.mcap)

        return plan

    def _world(self) -> WorldPlan:
        from simulator.samples.scan import find_scans, load_scan
        from simulator.streets.street import Roughness
        from simulator.streets.world_plan import WorldPlan

        scans = tuple(load_scan(path) for path in find_scans(self.data / "potholes")) if self.data is not None else ()
        return WorldPlan(roughness=Roughness[self.roughness.value] if self.roughness else None, scans=scans)

    def _map(self) -> MapFile | None:
        from simulator.maps.map_street import MapFile
        from simulator.maps.opendrive_xml import OpenDriveError

        if self.map_file is None:
            if self.origin is not None:
                raise OpenDriveError("--origin says where a map lies: give one with --map")
            return None
        return MapFile.at(self.map_file, _position(self.origin) if self.origin is not None else None)

    def _sensors(self) -> list[dict[str, object]]:
        """The list of a sensors.json or of a built-in rig, without cameras where no images are wanted."""
        from simulator.sensors.sensor_config import SensorConfigError, load_sensors
        from simulator.sensors.sensor_rigs import RIGS, sensor_rig

        if self.sensors not in RIGS and not Path(self.sensors).exists():
            raise SensorConfigError(f"{self.sensors}: no such file, and no built-in rig ({', '.join(RIGS)})")
        rig = sensor_rig(self.sensors) if self.sensors in RIGS else load_sensors(Path(self.sensors))
        return [e for e in rig.entries if self.images or not str(e["type"]).startswith("sensor.camera.")]


def _position(text: str) -> LatLon:
    from contract.geometry import LatLon
    from simulator.maps.opendrive_xml import OpenDriveError

    try:
        latitude, longitude = (float(number) for number in text.split(","))
        return LatLon(latitude_deg=latitude, longitude_deg=longitude)
    except ValueError:
        raise OpenDriveError(f"--origin {text}: expected LATITUDE,LONGITUDE in degrees, as 38.2466,21.7346") from None


def with_drive_options(command: Callable[..., None]) -> Callable[..., None]:
    """A command whose parameter `options: DriveOptions` is given by one option for each of its fields."""
    own = inspect.signature(command, eval_str=True).parameters.values()
    hints, names = get_type_hints(DriveOptions, include_extras=True), [field.name for field in fields(DriveOptions)]
    shared = [
        inspect.Parameter(
            field.name, inspect.Parameter.KEYWORD_ONLY, default=field.default, annotation=hints[field.name]
        )
        for field in fields(DriveOptions)
    ]

    @wraps(command)
    def taking_all(**values: Any) -> None:
        options = DriveOptions(**{name: values.pop(name) for name in names})
        command(**values, options=options)

    parameters = [
        *(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in own if parameter.name != "options"),
        *shared,
    ]
    taking_all.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # what typer reads
    taking_all.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return taking_all
