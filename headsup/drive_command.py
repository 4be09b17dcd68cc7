"""`headsup drive`: a vehicle along a recorded or live drive; `headsup record`: the same into a file, telling nobody."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from headsup.driving import Asked

Place = Annotated[
    str, typer.Argument(help="A recording (file or folder), or a sensor: udp://host:port, tcp://host:port.")
]
Calibration = Annotated[
    Path | None, typer.Option("--calibration", help="The car's calibration, TOML (docs/calibration.md).")
]
SensorHeight = Annotated[
    float | None,
    typer.Option("--sensor-height", min=0.3, max=5.0, help="Metres above the road, when there is no calibration file."),
]
Rate = Annotated[float, typer.Option("--rate", min=0.1, max=200, help="Sweeps a second, for clouds without stamps.")]
Ego = Annotated[int, typer.Option("--ego", min=0, help="Which vehicle of a recording in CARLA's layout.")]
Topics = Annotated[
    list[str] | None,
    typer.Option(
        "--topic",
        help="ROLE=TOPIC where a bag holds several, ROLE= for none; roles: sweep, image, fix, imu, odometry, motion, "
        "velocity.",
    ),
]
Start = Annotated[
    str | None,
    typer.Option(
        "--start", help="LAT,LON,ALT,HEADING of a drive without satellites (degrees, m): shown, not reported."
    ),
]
Json = Annotated[Path | None, typer.Option("--json", help="File for the counts of the drive.")]


def drive(
    source: Place,
    server: Annotated[
        str | None, typer.Option("--server", help="URL of the server; without one nothing is told.")
    ] = None,
    calibration: Calibration = None,
    sensor_height: SensorHeight = None,
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
    rate: Rate = 10.0,
    ego: Ego = 0,
    topic: Topics = None,
    start: Start = None,
    json_file: Json = None,
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
    from headsup.driving import Asked

    _quietly("drive")
    asked = Asked(
        source=source,
        calibration=calibration,
        sensor_height_m=sensor_height,
        rate_hz=rate,
        ego=ego,
        topics=tuple(topic or ()),
        start=start,
        server=server,
        realtime=realtime,
        record=record_file,
        state=state,
        quiet_zones=quiet_zones,
        as_if_now=as_if_now,
    )
    _run("drive", asked, json_file)


def record(
    source: Place,
    out: Annotated[Path, typer.Argument(help="A new MCAP file.")],
    calibration: Calibration = None,
    sensor_height: SensorHeight = None,
    rate: Rate = 10.0,
    ego: Ego = 0,
    topic: Topics = None,
    start: Start = None,
    json_file: Json = None,
) -> None:
    """Drive along a recording or a live sensor and write all of it as MCAP: sensors, pose, obstacles, what was shown.

    Foxglove opens the file, and so does `headsup drive`. Nothing is told to any server.

    Examples:

        headsup record runs/0001 drive.mcap --ego 1

        headsup record udp://0.0.0.0:7400 drive.mcap --calibration car.toml
    """
    from headsup.driving import Asked

    _quietly("record")
    asked = Asked(
        source=source,
        calibration=calibration,
        sensor_height_m=sensor_height,
        rate_hz=rate,
        ego=ego,
        topics=tuple(topic or ()),
        start=start,
        record=out,
    )
    _run("record", asked, json_file)


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
