"""`headsup drive`: a vehicle along a recorded or live drive; `headsup record`: the same into a file, telling nobody."""

from __future__ import annotations

import inspect
import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from headsup.driving import Asked


@dataclass(frozen=True, slots=True)
class Common:
    """What every drive can be asked."""

    source: Annotated[
        str, typer.Argument(help="A recording (file or folder), or a sensor: udp://host:port, tcp://host:port.")
    ]
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help="The car's calibration, TOML (docs/calibration.md).")
    ] = None
    sensor_height: Annotated[
        float | None,
        typer.Option(
            "--sensor-height", min=0.3, max=5.0, help="Metres above the road, when there is no calibration file."
        ),
    ] = None
    rate: Annotated[
        float, typer.Option("--rate", min=0.1, max=200, help="Sweeps a second, for clouds without stamps.")
    ] = 10.0
    ego: Annotated[int, typer.Option("--ego", min=0, help="Which vehicle of a recording in CARLA's layout.")] = 0
    topic: Annotated[
        list[str] | None,
        typer.Option(
            "--topic",
            help="ROLE=TOPIC where a bag holds several, ROLE= for none; roles: sweep, image, fix, imu, odometry, "
            "motion, velocity.",
        ),
    ] = None
    start: Annotated[
        str | None,
        typer.Option(
            "--start", help="LAT,LON,ALT,HEADING of a drive without satellites (degrees, m): shown, not reported."
        ),
    ] = None
    json_file: Annotated[Path | None, typer.Option("--json", help="File for the counts of the drive.")] = None

    def asked(self) -> Asked:
        """The same as a drive takes it."""
        from headsup.driving import Asked

        return Asked(
            source=self.source,
            calibration=self.calibration,
            sensor_height_m=self.sensor_height,
            rate_hz=self.rate,
            ego=self.ego,
            topics=tuple(self.topic or ()),
            start=self.start,
        )


def with_common(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the options of `Common` besides its own; it is given them as its first argument."""
    source, *others = inspect.signature(Common, eval_str=True).parameters.values()
    _, *own = inspect.signature(command, eval_str=True).parameters.values()
    taken = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in (source, *own, *others)]

    @wraps(command)
    def called(**given: Any) -> None:
        common = Common(**{name: given.pop(name) for name in (source.name, *(other.name for other in others))})
        command(common, **given)

    called.__signature__ = inspect.Signature(taken)  # type: ignore[attr-defined]  # what typer makes options from
    called.__annotations__ = {parameter.name: parameter.annotation for parameter in taken}
    return called


@with_common
def drive(
    common: Common,
    server: Annotated[
        str | None, typer.Option("--server", help="URL of the server; without one nothing is told.")
    ] = None,
    realtime: Annotated[
        bool | None,
        typer.Option(
            "--realtime/--no-realtime",
            help="At the sensor's pace, dropping what is late; default: live sensors yes, recordings no.",
        ),
    ] = None,
    record_file: Annotated[Path | None, typer.Option("--record", help="MCAP file for all that happens.")] = None,
    state: Annotated[
        Path | None,
        typer.Option("--state", help="Folder for what outlasts a drive; default: $XDG_STATE_HOME/headsup."),
    ] = None,
    quiet_zones: Annotated[
        Path | None, typer.Option("--quiet-zones", help="JSON file with places of which nothing leaves the car.")
    ] = None,
    as_if_now: Annotated[
        bool,
        typer.Option("--as-if-now", help="Move a recording's stamps to the present: servers refuse what is weeks old."),
    ] = False,
) -> None:
    """Drive along a recording or a live sensor: find obstacles, report them, warn the driver.

    What a source holds is recognised (docs/sources.md). Reports wait in an outbox on disk until the server has answered
    them, and what it said around the car is kept for the next drive (docs/vehicle-server.md). The vehicle's key is read
    from HEADSUP_API_KEY. Ends with the source, or at Ctrl-C; then prints what the drive came to.

    Examples:

        headsup drive drive.bag --calibration car.toml --server https://hazards.example --as-if-now

        headsup drive kitti/2011_09_26_drive_0001_sync --sensor-height 1.73 --realtime --record drive.mcap

        headsup drive udp://0.0.0.0:7400 --calibration car.toml --server https://hazards.example
    """
    _quietly("drive")
    asked = replace(
        common.asked(),
        server=server,
        realtime=realtime,
        record=record_file,
        state=state,
        quiet_zones=quiet_zones,
        as_if_now=as_if_now,
    )
    _run("drive", asked, common.json_file)


@with_common
def record(common: Common, out: Annotated[Path, typer.Argument(help="A new MCAP file.")]) -> None:
    """Drive along a recording or a live sensor and write all of it as MCAP: sensors, pose, obstacles, what was shown.

    Foxglove opens the file, and so does `headsup drive`. Nothing is told to any server.

    Examples:

        headsup record runs/0001 drive.mcap --ego 1

        headsup record udp://0.0.0.0:7400 drive.mcap --calibration car.toml
    """
    _quietly("record")
    _run("record", replace(common.asked(), record=out), common.json_file)


def _quietly(command: str) -> None:
    """Warnings in a line each, on standard error, with the command's name before them."""
    logging.basicConfig(level=logging.WARNING, format=f"headsup {command}: %(message)s")


def _run(command: str, asked: Asked, json_file: Path | None) -> None:
    from headsup.compiling import said_while_compiling
    from headsup.driving import DriveError, run
    from headsup.driving_summary import as_json, show

    try:
        if json_file is not None and not json_file.absolute().parent.is_dir():
            raise DriveError(f"--json: there is no folder {json_file.absolute().parent}")
        if json_file is not None and json_file.is_dir():
            raise DriveError(f"--json: {json_file} is a folder; name a file")
        if asked.record is not None and not asked.record.absolute().parent.is_dir():
            raise DriveError(f"{asked.record}: there is no folder {asked.record.absolute().parent}; make it first")
        with said_while_compiling(command):
            outcome = run(asked)
        show(outcome)
        if json_file is not None:
            json_file.write_text(as_json(outcome), encoding="utf-8")
        if outcome.totals.broken_off is not None:
            raise DriveError(f"the drive broke off: {outcome.totals.broken_off}")
    except DriveError as error:
        typer.echo(f"headsup {command}: {error}", err=True)
        raise typer.Exit(1) from None
    except OSError as error:
        typer.echo(f"headsup {command}: {error.filename or asked.source}: {error.strerror or error}", err=True)
        raise typer.Exit(1) from None
