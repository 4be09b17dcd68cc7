"""`headsup evaluate lidar`: recall, precision, confidence and classes of the LiDAR detector on simulated streets."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from headsup.evaluate.outputs import make_ready


def lidar(
    json_file: Annotated[Path | None, typer.Option("--json", help="File for everything that was counted.")] = None,
    pictures: Annotated[
        Path | None, typer.Option("--pictures", help="Folder for recall.png and reliability.png; made if missing.")
    ] = None,
    worlds: Annotated[int, typer.Option("--worlds", min=1, max=8, help="Streets to drive along, of eight.")] = 8,
    quick: Annotated[bool, typer.Option("--quick", help="One sensor at one speed and noise.")] = False,
) -> None:
    """Drive simulated LiDARs over known holes, bumps and boxes and print what was found, and what was not there.

    Streets of ISO 8608 classes B and C with curves down to 50 m, crown, grade, patches, covers, joints and parked cars,
    of seeds that nothing was built with; all sensors, range noise of 1 to 3 cm, one sweep and ten.

    Examples:

        headsup evaluate lidar --quick --worlds 2

        headsup evaluate lidar --json out/lidar.json --pictures out/lidar
    """
    from rich.console import Console
    from rich.progress import track

    from evaluation.lidar import TEST_SEEDS, conditions, run
    from evaluation.lidar_report import as_json, draw, markdown

    asked, seeds = conditions(quick), TEST_SEEDS[:worlds]
    try:
        make_ready(json_file)
        if pictures is not None:
            pictures.mkdir(parents=True, exist_ok=True)
        console = Console(stderr=True)
        scores = dict(track(run(seeds, asked), "driving", len(seeds) * len(asked), console=console, transient=True))
        typer.echo(markdown(scores), nl=False)
        if json_file is not None:
            json_file.write_text(as_json(scores), encoding="utf-8")
        if pictures is not None:
            draw(scores, pictures)
    except OSError as error:
        typer.secho(f"headsup evaluate lidar: {error}", err=True, fg=typer.colors.RED)
        raise typer.Exit(1) from error
