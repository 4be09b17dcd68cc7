"""`headsup simulate sensors`: how the simulated LiDARs compare with scans of real ones."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def sensors(
    data: Annotated[
        Path,
        typer.Option(
            "--data", envvar="HEADSUP_DATA", help="Folder with kitti_sequence/velodyne/*.bin and nuscenes/*.pcd.bin."
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for sensors.md and sensors.json; made if missing.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the simulated street and its turns.")] = 1,
) -> None:
    """Compare the LiDAR presets with real scans and print a table.

    The same code computes the same figures of both: points and rings, road points against distance, noise, intensity,
    incidence. The real streets are not the simulated one: what depends on buildings and sky differs.

    Examples:

        headsup simulate sensors --data ~/data

        headsup simulate sensors --data ~/data --out out/sensors
    """
    from rich.console import Console
    from rich.progress import track

    from simulator.sensors.sensor_comparison import ComparisonError
    from simulator.sensors.sensor_table import REAL_FRAMES, as_json, compare, markdown
    from simulator.streets.street import first_light_street
    from simulator.world import World

    try:
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
        turns = compare(data, World(first_light_street(seed)), seed)
        console = Console(stderr=True)
        comparisons = list(track(turns, "comparing", len(REAL_FRAMES), console=console, transient=True))
        tables = "\n\n".join(markdown(comparison) for comparison in comparisons) + "\n"
        typer.echo(tables, nl=False)
        if out is not None:
            (out / "sensors.md").write_text(tables, encoding="utf-8")
            (out / "sensors.json").write_text(as_json(comparisons), encoding="utf-8")
    except (ComparisonError, OSError) as error:
        typer.secho(f"headsup simulate sensors: {error}", err=True, fg=typer.colors.RED)
        raise typer.Exit(1) from error
