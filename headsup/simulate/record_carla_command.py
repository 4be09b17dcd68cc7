"""`headsup simulate carla`: record from a running CARLA server."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, NoReturn

import typer


def record_carla(
    out: Annotated[Path, typer.Option("--out", help="A new or empty folder for the recording.")],
    sensors: Annotated[str, typer.Option("--sensors", help="A sensors.json, or the built-in rig paper.")] = "paper",
    host: Annotated[str, typer.Option("--host", help="Where the CARLA server runs.")] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", min=1, max=65535, help="Its port.")] = 2000,
    egos: Annotated[int, typer.Option("--egos", min=1, max=50, help="Recorded vehicles, driven by autopilot.")] = 2,
    seconds: Annotated[float, typer.Option("--seconds", min=0.1, help="Simulated time to record.")] = 20.0,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Chooses spawn points and what traffic does.")] = 1,
    mcap: Annotated[bool, typer.Option(help="Write an MCAP file for each vehicle too.")] = True,
) -> None:
    """Record vehicles of a running CARLA 0.9.16 server in the layout that `headsup simulate drive` writes.

    Puts the server in synchronous mode, spawns the vehicles, and afterwards, also after Ctrl-C, destroys what it made
    and gives the server its settings back. One tick is one turn of the LiDAR.

    Examples:

        headsup simulate carla --out out/town

        headsup simulate carla --host 192.168.1.20 --egos 3 --seconds 60 --seed 7 --out out/three

        headsup simulate carla --sensors sensors.json --no-mcap --out out/mine
    """
    try:
        import carla  # noqa: F401  # what is missing without the extra; all else comes with the simulator
    except ImportError:
        _fail("the carla package is not installed; run pip install 'headsup[carla]'")
    import signal

    from rich.console import Console
    from rich.progress import Progress

    from simulator.carla_bridge.record import RecordingPlan, record
    from simulator.carla_bridge.sensors import tick_of
    from simulator.carla_bridge.session import connect
    from simulator.recording.files import RecordingError
    from simulator.sensors.sensor_config import SensorConfigError, load_sensors
    from simulator.sensors.sensor_rigs import RIGS, sensor_rig

    signal.signal(signal.SIGTERM, signal.default_int_handler)  # a supervisor's end restores the server as well
    try:
        chosen = sensor_rig(sensors) if sensors in RIGS else load_sensors(Path(sensors))
        plan = RecordingPlan(egos, seconds, seed, chosen, mcap=mcap)
        with Progress(console=Console(stderr=True), transient=True) as progress:
            task = progress.add_task("recording", total=round(seconds / tick_of(chosen)))
            ticks = record(connect(host, port), plan, out, lambda: progress.advance(task))
    except OSError as error:
        _fail(f"{error.filename or out}: {error.strerror or error}")
    except (RecordingError, SensorConfigError, RuntimeError) as error:  # CARLA's own errors are RuntimeErrors
        _fail(str(error))
    except KeyboardInterrupt:
        typer.echo("headsup simulate carla: interrupted; the recording is not finished", err=True)
        raise typer.Exit(130) from None
    typer.echo(f"{out}: {ticks} frames of {egos} vehicles")


def _fail(message: str) -> NoReturn:
    typer.echo(f"headsup simulate carla: {message}", err=True)
    raise typer.Exit(1)
