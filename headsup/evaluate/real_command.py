"""`headsup evaluate real`: false alarms on recorded drives along sound roads."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from detector.types import DetectedObstacle


def real(
    data: Annotated[
        Path,
        typer.Option(
            "--data", envvar="HEADSUP_DATA", help="Folder with kitti_sequence/velodyne/*.bin and kitti_drive/*.laz."
        ),
    ],
) -> None:
    """Search recorded scans of sound roads: each sweep alone, and a drive's sweeps together.

    Holes that several sweeps of the drive agree on are printed with their place; poses come from matching the sweeps.

    Examples:

        headsup evaluate real --data ~/data
    """
    from rich.console import Console
    from rich.progress import track

    from detector.errors import DetectorError
    from evaluation.real_roads import along_a_drive, lasting_holes, single_sweeps
    from vehicle_client.sources.frame import SourceError

    console = Console(stderr=True)
    alone = sorted(data.glob("kitti_sequence/velodyne/*.bin"))
    drive = sorted(data.glob("kitti_drive/*.laz"))
    if not alone and not drive:
        typer.secho(f"headsup evaluate real: no kitti_sequence or kitti_drive under {data}", err=True, fg="red")
        raise typer.Exit(1)
    try:
        for path, obstacles in track(single_sweeps(alone), "sweeps", len(alone), console=console, transient=True):
            for obstacle in obstacles:
                typer.echo(f"{path.name}: {_in_words(obstacle)}")
        sweeps = list(track(along_a_drive(drive), "drive", len(drive), console=console, transient=True))
    except (OSError, SourceError, DetectorError) as error:
        typer.secho(f"headsup evaluate real: {error}", err=True, fg="red")
        raise typer.Exit(1) from error
    for together, name in ((False, "one sweep"), (True, "ten sweeps")):
        found = [o for s in sweeps for o in (s.together if together else s.of_sweep)]
        counts = {kind: sum(o.kind.value == kind for o in found) for kind in ("pothole", "bump", "debris")}
        typer.echo(f"drive of {len(sweeps)} sweeps, {name}: " + ", ".join(f"{n} {kind}" for kind, n in counts.items()))
        for place, times in lasting_holes(sweeps, together=together):
            typer.echo(f"  hole seen {times} times at ({place[0]:.1f}, {place[1]:.1f}) m of the first sweep's frame")


def _in_words(obstacle: DetectedObstacle) -> str:
    x, y = obstacle.centre_m[:2]
    return f"{obstacle.kind.value} at ({x:.1f}, {y:.1f}) m, {100 * obstacle.relief_m:.0f} cm, {obstacle.hits} hits"
