"""`headsup evaluate table1`: scanned potholes in a road, by density and noise."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from headsup.evaluate.outputs import make_ready

if TYPE_CHECKING:
    from rich.table import Table

    from evaluation.table1 import Row, Scored


def table1(
    data: Annotated[Path, typer.Option("--data", help="Folder with PLY scans of moulds, or with potholes/*.ply.")],
    json_file: Annotated[Path | None, typer.Option("--json", help="Write every row to this file.")] = None,
    save_labels: Annotated[
        Path | None, typer.Option("--save-labels", help="Folder for one NPZ per scan, density and noise (flat road).")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="The same seed makes the same scenes.")] = 1,
    peers: Annotated[bool, typer.Option(help="Score the peers too (about half of the time).")] = True,
) -> None:
    """Rebuild the paper's Table I: pothole points called pothole (RP), road points called road (RR).

    Each scan is set into a flat road and into one with a 2 % crown and 1 mm of roughness, thinned to 100, 50, 10 and
    5 % of its points, with 0, 0.25, 0.5 and 1 mm of noise on all of them.

    Examples:

        headsup evaluate table1 --data ~/data

        headsup evaluate table1 --data scans --json table1.json --save-labels out/labels --no-peers
    """
    from rich.console import Console
    from rich.progress import track

    from evaluation.composed_scan import ScanError
    from evaluation.table1 import METHODS, averages, scans_in, scene_count, score_scans

    methods = tuple(METHODS) if peers else ("surface", "saliency")
    rows: list[Row] = []
    try:
        make_ready(json_file)
        if save_labels is not None:
            save_labels.mkdir(parents=True, exist_ok=True)
        scans = scans_in(data)
        scenes = score_scans(scans, seed, methods)
        progress = Console(stderr=True)
        for scored in track(scenes, "scoring", scene_count(len(scans)), console=progress, transient=True):
            rows += scored.rows()
            if save_labels is not None:
                _save(scored, save_labels)
        rows += averages(rows)
        if json_file is not None:
            records = {"seed": seed, "rows": [row.record() for row in rows]}
            json_file.write_text(json.dumps(records, indent=1) + "\n")
    except (ScanError, OSError) as error:
        typer.echo(f"headsup evaluate table1: {error}", err=True)
        raise typer.Exit(1) from None
    console = Console(width=150)
    for road in dict.fromkeys(row.road for row in rows):
        console.print(_by_scan([row for row in rows if row.road == road]))
        console.print(_by_density([row for row in rows if row.road == road and row.scan == "average"]))


def _save(scored: Scored, folder: Path) -> None:
    import numpy as np

    from evaluation.composed_scan import FLAT

    if scored.road == FLAT:
        np.savez_compressed(
            folder / f"{scored.stem}.npz",
            points=scored.scene.points_mm,
            truth=scored.scene.truth.astype(np.uint8),
            saliency=scored.called["saliency"].astype(np.uint8),
            surface=scored.called["surface"].astype(np.uint8),
        )


def _by_scan(rows: list[Row]) -> Table:
    """Every scan at full density without noise, as the paper prints it."""
    from rich.table import Table

    table = Table("scan", "method", "RP %", "NR %", "NP %", "RR %", title=f"{rows[0].road}: 100 %, no noise")
    for row in rows:
        if row.density_percent == 100 and row.noise_mm == 0.0:
            rates = (row.rates.RP, row.rates.NR, row.rates.NP, row.rates.RR)
            table.add_row(row.scan, row.method, *(f"{rate:.2f}" for rate in rates))
    return table


def _by_density(rows: list[Row]) -> Table:
    """Averages: one line per method and noise, RP / RR per density."""
    from rich.table import Table

    from evaluation.composed_scan import DENSITIES_PERCENT, FLAT
    from evaluation.table1 import PAPER

    table = Table(
        "method", "noise mm", *(f"RP / RR at {d} %" for d in DENSITIES_PERCENT), title=f"{rows[0].road}: mean"
    )
    if rows[0].road == FLAT.name:
        table.add_row("paper (13 scans)", "0", *(f"{PAPER[d][0]:.2f} / {PAPER[d][1]:.2f}" for d in DENSITIES_PERCENT))
    for method, noise in dict.fromkeys((row.method, row.noise_mm) for row in rows):
        cells = {r.density_percent: r.rates for r in rows if (r.method, r.noise_mm) == (method, noise)}
        table.add_row(method, f"{noise:g}", *(f"{cells[d].RP:.2f} / {cells[d].RR:.2f}" for d in DENSITIES_PERCENT))
    return table
