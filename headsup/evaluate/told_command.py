"""`headsup evaluate told`: what whole drives would tell others of the road, and what they miss."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from headsup.evaluate.outputs import make_ready

if TYPE_CHECKING:
    from evaluation.told import RecordedDrive, Scores

STARTS, RECORDED_SHARE = 40, 0.1


def told(
    data: Annotated[
        Path | None,
        typer.Option(
            "--data",
            envvar="HEADSUP_DATA",
            help="Folder with kitti_drive/*.laz, a sound road; without it only streets.",
        ),
    ] = None,
    worlds: Annotated[int, typer.Option("--worlds", min=0, max=8, help="Streets to drive along, of eight.")] = 6,
    starts: Annotated[int, typer.Option("--starts", min=1, help="Drives along the recording.")] = STARTS,
    share: Annotated[
        float, typer.Option("--share", min=0.0, max=0.9, help="Of the recording's sweeps, so many are dropped.")
    ] = RECORDED_SHARE,
    json_file: Annotated[Path | None, typer.Option("--json", help="File for everything that was counted.")] = None,
) -> None:
    """Make whole drives, also with sweeps that were dropped, and count what they would tell: all of it, and nothing
    else.

    Simulated LiDARs at 50 km/h along streets with a hole, bump or box every 11 m; and a recorded drive along a sound
    road, begun at any of its sweeps: the three bollards beside it are known for posts, and all else is wrong. Takes
    about a minute a street and five seconds a start.

    Examples:

        headsup evaluate told --worlds 1

        headsup evaluate told --data ~/data --starts 100 --share 0.3 --worlds 0
    """
    from rich.console import Console
    from rich.progress import track

    from detector.errors import DetectorError
    from evaluation.lidar import TEST_SEEDS
    from evaluation.told import SENSORS, recorded, simulated, sweeps_and_car
    from vehicle_client.sources.frame import SourceError

    if not worlds and data is None:
        typer.secho("headsup evaluate told: nothing to drive along: give --data, or streets", err=True, fg="red")
        raise typer.Exit(1)
    console = Console(stderr=True)
    scores: Scores = {}
    drives: list[RecordedDrive] = []
    try:
        make_ready(json_file)
        # First what can be missing.
        recording = None if data is None else sweeps_and_car(data / "kitti_drive")
        for scores in track(  # noqa: B007  # the last ones count
            simulated(TEST_SEEDS[:worlds]), "streets", worlds * len(SENSORS), console=console, transient=True
        ):
            pass
        if recording is not None:
            along = recorded(*recording, range(starts), share)
            drives = list(track(along, "recording", starts, console=console, transient=True))
    except (OSError, SourceError, DetectorError) as error:
        typer.secho(f"headsup evaluate told: {error}", err=True, fg=typer.colors.RED)
        raise typer.Exit(1) from error
    _print(scores, drives)
    if json_file is not None:
        json_file.write_text(json.dumps(_as_json(scores, drives), indent=1) + "\n", encoding="utf-8")


def _print(scores: Scores, drives: list[RecordedDrive]) -> None:
    if scores:
        trials = list(next(iter(scores.values())).passed)
        typer.echo("| sensor | dropped | " + " | ".join(trials) + " | told twice | not there |")
        typer.echo("|---|---|" + "---|" * (len(trials) + 2))
        for (sensor, share), score in scores.items():
            cells = [f"{score.told[name]}/{score.passed[name]}" for name in trials]
            wrong = f"{score.false.total()} in {score.metres:.0f} m"
            typer.echo(f"| {sensor} | {share:.0%} | " + " | ".join([*cells, str(score.twice), wrong]) + " |")
    for drive in drives:
        for obstacle in drive.told:
            x, y = obstacle.centre_m[:2]
            typer.echo(
                f"begun at sweep {drive.first}, {drive.dropped} of {drive.sweeps} dropped: {obstacle.kind.value} at "
                f"({x:.1f}, {y:.1f}) m of the first sweep's frame, {obstacle.length_m:.2f} x {obstacle.width_m:.2f} m, "
                f"{100 * obstacle.relief_m:.0f} cm"
            )
    if drives:
        typer.echo(f"{len(drives)} drives along the recording: {sum(len(d.told) for d in drives)} told")


def _as_json(scores: Scores, drives: list[RecordedDrive]) -> dict[str, Any]:
    streets = [
        {
            "sensor": sensor,
            "dropped": share,
            "told": dict(score.told),
            "passed": dict(score.passed),
            "twice": score.twice,
            "not_there": dict(score.false),
            "metres": score.metres,
        }
        for (sensor, share), score in scores.items()
    ]
    recordings = [
        {
            "first": d.first,
            "sweeps": d.sweeps,
            "dropped": d.dropped,
            "told": [{"kind": o.kind.value, "centre_m": o.centre_m.tolist(), "relief_m": o.relief_m} for o in d.told],
        }
        for d in drives
    ]
    return {"streets": streets, "recorded": recordings}
