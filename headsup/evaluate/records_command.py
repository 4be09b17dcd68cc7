"""`headsup evaluate records`: the records of road crews as obstacles."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def records(
    data: Annotated[Path, typer.Option(help="CSV with dtTime, VehicleName, Latitude, Longitude.", exists=True)],
    accuracy_m: Annotated[float, typer.Option(help="Standard deviation of a position, metres.", min=0.3, max=20)] = 5.0,
    database_url: Annotated[str | None, typer.Option(help="Fresh database that keeps the result; else none.")] = None,
) -> None:
    """Replay records of repaired potholes in time order through the server's rule, and count what is distinct.

    Examples:

        headsup evaluate records --data data/records/syracuse_potholes.csv

        headsup evaluate records --data syracuse_potholes.csv --accuracy-m 3 --database-url sqlite+aiosqlite:///s.sqlite3
    """
    import asyncio
    import tempfile

    from rich.progress import Progress

    from evaluation.records import RecordsError, distinct_places, read_records, replay_records

    try:
        found, swapped = read_records(data)
    except RecordsError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(1) from error
    if swapped:
        typer.echo("the columns Latitude and Longitude bear each other's names: read the other way round")
    with tempfile.TemporaryDirectory(prefix="headsup-records-") as folder, Progress(transient=True) as progress:
        task = progress.add_task("replaying", total=len(found))
        url = database_url or f"sqlite+aiosqlite:///{folder}/records.sqlite3"
        done = asyncio.run(replay_records(found, accuracy_m, url, lambda count: progress.advance(task, count)))
    typer.echo(f"{done.records} records of {len({r.vehicle for r in found})} vehicles, accuracy {accuracy_m:g} m")
    typer.echo("decisions: " + ", ".join(f"{count} {name}" for name, count in sorted(done.decisions.items())))
    distinct = sum(done.obstacles.values())
    states = ", ".join(f"{count} {state}" for state, count in sorted(done.obstacles.items()))
    typer.echo(f"{distinct} distinct obstacles ({states}), {done.merged} more merged into others")
    typer.echo(f"passes of each: {done.sightings.mean():.1f} in the mean, at most {done.sightings.max()}")
    typer.echo("for comparison, groups of records that all lie within a distance of each other:")
    for sds in (2, 4, 6):
        within_m = sds * accuracy_m
        typer.echo(f"  {within_m:g} m ({sds} standard deviations): {distinct_places(found, within_m)}")
