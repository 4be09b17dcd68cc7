"""`headsup demo`: the whole loop in one command."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def demo(
    out: Annotated[Path, typer.Option("--out", help="Folder for pictures, film, report and summary.")] = Path(
        "out/demo"
    ),
    data: Annotated[
        Path | None,
        typer.Option("--data", help="Folder with potholes/*.ply: real scans take the place of procedural potholes."),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="The same seed makes the same decisions.")] = 1,
    video: Annotated[bool, typer.Option(help="Film the second car's drive (about a minute of the run).")] = True,
) -> None:
    """Drive five cars past two potholes, a bump and debris, and show who warned whom.

    Starts a server on loopback, builds a street, and writes AR pictures, a film, the obstacles as GeoJSON,
    summary.json and report.html; prints every decision and how far ahead the second car was warned.

    Examples:

        headsup demo

        headsup demo --data ~/data --out out/real-scans

        headsup demo --seed 7 --no-video
    """
    import signal

    from headsup.compiling import said_while_compiling
    from headsup.demo.problem import DemoError
    from headsup.demo.story import tell
    from simulator.samples.scan import ScanError
    from vehicle_client.link.outbox import OutboxError

    # Ended by a supervisor is ended like by Ctrl-C: the server and the folder of the run must not stay behind.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        if out.exists() and not out.is_dir():
            raise DemoError(f"{out} is a file; give --out a folder")
        with said_while_compiling("demo"):
            tell(out, data, seed, with_video=video)
    except OSError as error:
        typer.echo(f"headsup demo: {error.filename or out}: {error.strerror or error}", err=True)
        raise typer.Exit(1) from None
    except (DemoError, OutboxError, ScanError) as error:
        typer.echo(f"headsup demo: {error}", err=True)
        raise typer.Exit(1) from None
    except KeyboardInterrupt:
        typer.echo("headsup demo: interrupted", err=True)
        raise typer.Exit(130) from None
