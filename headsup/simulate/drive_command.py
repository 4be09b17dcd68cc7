"""`headsup simulate drive`: recordings of several vehicles on a street from a seed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from headsup.simulate.drive_options import DriveOptions, with_drive_options

if TYPE_CHECKING:
    from simulator.record import RecordingPlan
    from simulator.scenario import Scenario


@with_drive_options
def drive(
    out: Annotated[Path, typer.Option("--out", help="A new or empty folder for the recording.")],
    seed: Annotated[int, typer.Option("--seed", min=0, help="The same seed and options give the same bytes.")] = 1,
    *,
    options: DriveOptions,
) -> None:
    """Drive vehicles through a random street, or a map, and record what their sensors see, with the truth.

    Writes ego0, ego1, ... in the layout of CARLA recordings, per-point labels, exact poses, GNSS, IMU and odometry,
    obstacles.json with every obstacle and when it changed, overview.png, an MCAP file per vehicle, and recording.json
    last.

    Examples:

        headsup simulate drive --egos 2 --seconds 20 --seed 1 --out runs/0001

        headsup simulate drive --sensors hdl64 --no-images --seconds 60 --out runs/lidar

        headsup simulate drive --map docs/examples/crossroads.xodr --out runs/crossroads

    `headsup simulate dataset` makes many of them.
    """
    from simulator.maps.opendrive_xml import OpenDriveError
    from simulator.recording.files import RecordingError
    from simulator.samples.scan import ScanError
    from simulator.sensors.sensor_config import SensorConfigError

    try:
        happening = _record(options.planner()(seed), out)
    except OSError as error:
        typer.echo(f"headsup simulate drive: {error.filename or out}: {error.strerror or error}", err=True)
        raise typer.Exit(1) from None
    except (OpenDriveError, RecordingError, ScanError, SensorConfigError) as error:
        typer.echo(f"headsup simulate drive: {error}", err=True)
        raise typer.Exit(1) from None
    except KeyboardInterrupt:
        typer.echo("headsup simulate drive: interrupted; what is in the folder is not whole", err=True)
        raise typer.Exit(130) from None
    vehicles = f"{options.egos} vehicle{'s' if options.egos > 1 else ''}"
    obstacles, changes = len(happening.changing.street.obstacles), len(happening.changing.changes)
    typer.echo(f"{out}: {vehicles}, {obstacles} obstacles, {changes} changes")


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
