"""`headsup evaluate volume`: potholes before a depth camera, beside the sand that filled them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from headsup.evaluate.outputs import make_ready


def volume(
    data: Annotated[Path, typer.Option("--data", help="Folder with pothole_rgbd/*.ply, or with the PLY scans.")],
    json_file: Annotated[Path | None, typer.Option("--json", help="Write what was found to this file.")] = None,
) -> None:
    """Find and measure the potholes in scans of a depth camera.

    The volume stands beside that of the sand which filled the hole, where it was measured (p1, p2).

    Examples:

        headsup evaluate volume --data ~/data

        headsup evaluate volume --data scans --json volumes.json
    """
    from rich.console import Console
    from rich.progress import track
    from rich.table import Table

    from detector.errors import DetectorError
    from evaluation.composed_scan import ScanError
    from evaluation.depth_camera import camera_scans_in, measure_scan

    table = Table("scan", "kind", "length m", "width m", "depth m", "volume l", "sand l", "difference")
    records = []
    try:
        make_ready(json_file)
        for path in track(camera_scans_in(data), "measuring", console=Console(stderr=True), transient=True):
            scan = measure_scan(path)
            records.append(scan.record())
            for o in scan.obstacles:
                sand = "" if scan.sand_m3 is None else f"{1e3 * scan.sand_m3:.3f}"
                difference = "" if scan.sand_m3 is None else f"{100.0 * (o.volume_m3 / scan.sand_m3 - 1.0):+.1f} %"
                sizes = (f"{size:.3f}" for size in (o.length_m, o.width_m, o.relief_m, 1e3 * o.volume_m3))
                table.add_row(scan.name, o.kind.value, *sizes, sand, difference)
            if not scan.obstacles:
                table.add_row(scan.name, "nothing found")
        if json_file is not None:
            json_file.write_text(json.dumps(records, indent=1) + "\n")
    except (ScanError, DetectorError, OSError) as error:
        typer.echo(f"headsup evaluate volume: {error}", err=True)
        raise typer.Exit(1) from None
    Console(width=120).print(table)
