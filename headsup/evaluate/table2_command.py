"""`headsup evaluate table2`: labelled potholes in real stereo frames."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from headsup.evaluate.outputs import make_ready

if TYPE_CHECKING:
    from rich.table import Table

    from evaluation.table2 import ScoredFrame, Summary


def table2(
    data: Annotated[Path, typer.Option("--data", help="Folder with dataset*/NN_disparity.png and NN_label.png.")],
    save_masks: Annotated[Path | None, typer.Option("--save-masks", help="Folder for dataset*/NN_mask.png.")] = None,
    pictures: Annotated[
        Path | None, typer.Option("--pictures", help="Folder for dataset*/NN.png: labels white, found red.")
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the sums to this file.")] = None,
) -> None:
    """Rebuild the paper's Table II: pothole pixels and potholes in real stereo frames.

    Full frames, and crops in which potholes fill the share that the paper's figures imply. A pothole is correct when
    half of its label is covered; a found region is incorrect when less than a tenth of it is labelled.

    Examples:

        headsup evaluate table2 --data ~/data

        headsup evaluate table2 --data stereo --save-masks out/masks --pictures out/pictures --json table2.json
    """
    from rich.console import Console
    from rich.progress import track

    from evaluation.stereo import StereoError, frames_in
    from evaluation.table2 import score_frames, summaries

    scored: list[ScoredFrame] = []
    try:
        make_ready(json_file)
        files = frames_in(data)
        progress = Console(stderr=True)
        for frame in track(score_frames(files), "scoring", len(files), console=progress, transient=True):
            scored.append(frame)
            _write(frame, save_masks, pictures)
        sums = summaries(scored)
        if json_file is not None:
            json_file.write_text(json.dumps([summary.record() for summary in sums], indent=1) + "\n")
    except (StereoError, OSError) as error:
        typer.echo(f"headsup evaluate table2: {error}", err=True)
        raise typer.Exit(1) from None
    console = Console(width=120)
    console.print(_table(sums))
    console.print(_beside_the_paper(sums))


def _write(scored: ScoredFrame, masks: Path | None, pictures: Path | None) -> None:
    import numpy as np

    from evaluation.table2 import overlay

    name = f"{scored.frame.dataset}/{scored.frame.number}"
    if masks is not None:
        _save(masks / f"{name}_mask.png", np.where(scored.mask, np.uint8(255), np.uint8(0)))
    if pictures is not None:
        _save(pictures / f"{name}.png", overlay(scored))


def _save(path: Path, picture: object) -> None:
    import cv2

    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), picture):  # type: ignore[call-overload]  # its stubs know no uint8 array
        raise OSError(f"{path}: cannot be written")


def _table(sums: list[Summary]) -> Table:
    from rich.table import Table

    table = Table("", "frames", "region", "recall", "precision", "accuracy", "F", "correct / incorrect / missed")
    for summary in sums:
        for region, pixels in (("full", summary.full), ("crop", summary.crop)):
            rates = (pixels.recall, pixels.precision, pixels.accuracy, pixels.f_score)
            counts = summary.potholes
            potholes = f"{counts.correct} / {counts.incorrect} / {counts.missed}" if region == "full" else ""
            table.add_row(summary.name, str(summary.frames), region, *(f"{rate:.3f}" for rate in rates), potholes)
    return table


def _beside_the_paper(sums: list[Summary]) -> Table:
    from rich.table import Table

    from evaluation.table2 import PRINTED

    table = Table("", "F of dataset 1 / 2 / 3", "total R / P / A / F", "correct / incorrect / missed")
    total = next(summary for summary in sums if summary.name == "total")
    by_dataset = {summary.name: summary for summary in sums}
    for region in ("full", "crop"):
        pixels = getattr(total, region)
        dataset_f = (
            f"{getattr(by_dataset[name], region).f_score:.3f}" if name in by_dataset else "-"
            for name in ("dataset1", "dataset2", "dataset3")
        )
        rates = (pixels.recall, pixels.precision, pixels.accuracy, pixels.f_score)
        counts = (total.potholes.correct, total.potholes.incorrect, total.potholes.missed)
        _add(table, f"surface, {region}", tuple(dataset_f), rates, counts)
    for line in PRINTED:
        _add(table, line.name, tuple(f"{f:.3f}" for f in line.dataset_f), line.total, line.potholes)
    return table


def _add(
    table: Table, name: str, dataset_f: tuple[str, ...], rates: tuple[float, ...], counts: tuple[int, ...]
) -> None:
    table.add_row(
        name, " / ".join(dataset_f), " / ".join(f"{rate:.3f}" for rate in rates), " / ".join(str(n) for n in counts)
    )
