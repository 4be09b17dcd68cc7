"""`headsup simulate drive`: recordings of several vehicles on a street from a seed."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from simulator.record import RecordingPlan
    from simulator.scenario import Scenario
    from simulator.worlds import WorldPlan


class RoadClass(StrEnum):
    """Road classes of ISO 8608 as options."""

    A = "A"
    B = "B"
    C = "C"


def drive(
    out: Annotated[Path, typer.Option("--out", help="A new or empty folder for the recording.")],
    egos: Annotated[int, typer.Option("--egos", min=1, max=8, help="Recording vehicles.")] = 2,
    seconds: Annotated[float, typer.Option("--seconds", min=0.1, max=300.0, help="Recorded by each vehicle.")] = 20.0,
    seed: Annotated[int, typer.Option("--seed", min=0, help="The same seed and options give the same bytes.")] = 1,
    sensors: Annotated[
        str, typer.Option("--sensors", help="A sensors.json, or a built-in rig: paper, hdl64, hdl32.")
    ] = "paper",
    images: Annotated[bool, typer.Option(help="Cameras take most of the time; LiDAR alone is fast.")] = True,
    mcap: Annotated[bool, typer.Option(help="An MCAP file per vehicle beside CARLA's layout.")] = True,
    traffic: Annotated[bool, typer.Option(help="Other cars and pedestrians.")] = True,
    changes: Annotated[bool, typer.Option(help="Obstacles appear, grow or go between two vehicles' passes.")] = True,
    roughness: Annotated[
        RoadClass | None, typer.Option("--roughness", help="Road class of ISO 8608; by default from the seed.")
    ] = None,
    data: Annotated[
        Path | None, typer.Option("--data", help="Folder with potholes/*.ply: real scans as the street's potholes.")
    ] = None,
) -> None:
    """Drive vehicles through a random street and record what their sensors see, with the truth.

    Writes ego0, ego1, ... in the layout of CARLA recordings, per-point labels, exact poses, GNSS, IMU and odometry,
    obstacles.json with every obstacle and when it changed, overview.png, an MCAP file per vehicle, and recording.json
    last.

    Examples:

        headsup simulate drive --egos 2 --seconds 20 --seed 1 --out runs/0001

        headsup simulate drive --sensors hdl64 --no-images --seconds 60 --out runs/lidar

        for i in $(seq 100); do headsup simulate drive --seed $i --out runs/$i; done
    """
    from simulator.record import RecordingPlan
    from simulator.recording.files import RecordingError
    from simulator.scan import ScanError
    from simulator.scenario import ScenarioPlan
    from simulator.sensor_config import SensorConfigError

    try:
        world = _world(roughness, data)
        scenario_plan = ScenarioPlan(seed, egos, seconds, traffic=traffic, changes=changes, world=world)
        happening = _record(RecordingPlan(scenario_plan, _entries(sensors, images=images), mcap=mcap), out)
    except OSError as error:
        typer.echo(f"headsup simulate drive: {error.filename or out}: {error.strerror or error}", err=True)
        raise typer.Exit(1) from None
    except (RecordingError, ScanError, SensorConfigError) as error:
        typer.echo(f"headsup simulate drive: {error}", err=True)
        raise typer.Exit(1) from None
    except KeyboardInterrupt:
        typer.echo("headsup simulate drive: interrupted; what is in the folder is not whole", err=True)
        raise typer.Exit(130) from None
    changed = len(happening.changing.changes)
    typer.echo(f"{out}: {egos} vehicles, {len(happening.changing.street.obstacles)} obstacles, {changed} changes")


def _world(roughness: RoadClass | None, data: Path | None) -> WorldPlan:
    from simulator.scan import find_scans, load_scan
    from simulator.street import Roughness
    from simulator.worlds import WorldPlan

    scans = tuple(load_scan(path) for path in find_scans(data / "potholes")) if data is not None else ()
    return WorldPlan(roughness=Roughness[roughness.value] if roughness else None, scans=scans)


def _entries(sensors: str, *, images: bool) -> list[dict[str, object]]:
    """The list of a sensors.json or of a built-in rig, without cameras where no images are wanted."""
    from simulator.sensor_config import SensorConfigError, load_sensors
    from simulator.sensor_rigs import RIGS, sensor_rig

    if sensors not in RIGS and not Path(sensors).exists():
        raise SensorConfigError(f"{sensors}: no such file, and no built-in rig ({', '.join(RIGS)})")
    rig = sensor_rig(sensors) if sensors in RIGS else load_sensors(Path(sensors))
    return [entry for entry in rig.entries if images or not str(entry["type"]).startswith("sensor.camera.")]


def _record(plan: RecordingPlan, out: Path) -> Scenario:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from simulator.record import record

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bars:
        tasks = [bars.add_task(f"ego{ego}", total=plan.frames) for ego in range(plan.scenario.egos)]

        def show(written: list[int]) -> None:
            for task, count in zip(tasks, written, strict=True):
                bars.update(task, completed=count)

        return record(plan, out, show)
