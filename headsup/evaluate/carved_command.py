"""`headsup evaluate carved`: holes carved into scans of real, sound roads."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def carved(
    data: Annotated[
        Path,
        typer.Option(
            "--data", envvar="HEADSUP_DATA", help="Folder with kitti_sequence/velodyne/*.bin or kitti_drive/*.laz."
        ),
    ],
    every: Annotated[int, typer.Option("--every", min=1, help="Take every n-th scan.")] = 1,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the holes' shapes and places.")] = 1,
) -> None:
    """Carve a hole into each real scan, ray by ray, and count how many one sweep shows.

    A hole is carved where the road ahead is seen, flat and free; rays that met the road inside its outline go on to
    its floor or wall.

    Examples:

        headsup evaluate carved --data ~/data

        headsup evaluate carved --data ~/data --every 10
    """
    from rich.console import Console
    from rich.progress import track

    from detector.errors import DetectorError
    from evaluation.carving import DISTANCES_M, SIZES_M, run, scans
    from vehicle_client.sources.frame import SourceError

    try:
        paths = scans(data)[::every]
        score = list(track(run(paths, seed), "carving", len(paths), console=Console(stderr=True), transient=True))[-1]
    except (OSError, SourceError, DetectorError) as error:
        typer.secho(f"headsup evaluate carved: {error}", err=True, fg=typer.colors.RED)
        raise typer.Exit(1) from error
    typer.echo("found / carved (of which the sweep has at least 3 returns deeper than 2 cm)")
    typer.echo("| hole | " + " | ".join(f"{distance:.0f} m" for distance in DISTANCES_M) + " |")
    typer.echo("|---|" + "---|" * len(DISTANCES_M))
    for size in SIZES_M:
        keys = [(size[0], distance) for distance in DISTANCES_M]
        cells = [f"{score.found.get(k, 0)}/{score.tried.get(k, 0)} ({score.shown.get(k, 0)})" for k in keys]
        name = f"{100 * size[0]:.0f} x {100 * size[1]:.0f} cm, {100 * size[2]:.0f} cm deep"
        typer.echo(f"| {name} | " + " | ".join(cells) + " |")
