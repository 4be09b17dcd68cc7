"""`headsup simulate dataset`: many drives, one seed each, in one folder that says what they are."""

from __future__ import annotations

import errno
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from headsup.simulate.drive_options import DriveOptions, with_drive_options

if TYPE_CHECKING:
    from rich.progress import Progress

    from simulator.dataset import Content, PlannedDrive

NO_DRIVE_WILL_DO = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM)
"""After these the next drive would fail too."""


@with_drive_options
def dataset(
    out: Annotated[Path, typer.Option("--out", help="Folder of the data set; drives that it holds are kept.")],
    drives: Annotated[int, typer.Option("--drives", min=1, max=9999, help="Recordings, each on its own street.")] = 100,
    first_seed: Annotated[int, typer.Option("--first-seed", min=0, help="Of the first drive; then one by one.")] = 1,
    *,
    options: DriveOptions,
) -> None:
    """Make a data set of many drives, and describe it.

    Writes OUT/0001, OUT/0002, ... as `headsup simulate drive` does, and OUT/dataset.json last: seeds, a split into
    train, val and test by whole drives, what each drive holds, and the options. Run the same command again to go on
    after an interruption: whole drives are kept, an unfinished one is made anew. Where there are more cores than
    vehicles, several drives are made at once. A drive that fails is reported with its seed, and the others go on.

    Examples:

        headsup simulate dataset --drives 100 --egos 2 --seconds 20 --out datasets/a

        headsup simulate dataset --drives 500 --sensors hdl64 --no-images --no-mcap --out datasets/lidar

        headsup simulate dataset --drives 20 --first-seed 1001 --roughness C --out datasets/rough
    """
    from simulator.dataset import DatasetError, alone, planned, write_dataset
    from simulator.maps.opendrive_xml import OpenDriveError
    from simulator.samples.scan import ScanError
    from simulator.sensors.sensor_config import SensorConfigError

    try:
        plan = options.planner()
        wanted = planned(out, [plan(seed) for seed in range(first_seed, first_seed + drives)])
        with alone(out):
            failed = _make(out, wanted)
            if failed:
                _complain(f"{failed} of {drives} drives failed; the same command tries them again")
                raise typer.Exit(1)
            _tell(out, write_dataset(out, wanted))
    except OSError as error:
        _complain(f"{error.filename or out}: {error.strerror or error}")
        raise typer.Exit(1) from None
    except (DatasetError, OpenDriveError, ScanError, SensorConfigError) as error:
        _complain(str(error))
        raise typer.Exit(1) from None
    except KeyboardInterrupt:
        _complain("interrupted; the same command goes on where it stopped")
        raise typer.Exit(130) from None


def _make(out: Path, drives: list[PlannedDrive]) -> int:
    """Make what is missing, and say how many failed."""
    from simulator.dataset import check_room
    from simulator.record_many import record_many

    there = {drive.folder: drive.is_there for drive in drives}
    made = [drive for drive in drives if there[drive.folder]]
    missing = [drive for drive in drives if not there[drive.folder]]
    check_room(out, made, len(missing))
    for drive in missing:
        drive.clear()
    if missing:
        (out / "dataset.json").unlink(missing_ok=True)
    with _progress() as bar:
        task = bar.add_task(f"{len(made)} of {len(drives)} drives", total=sum(drive.frames for drive in missing))
        written: dict[Path, int] = {}

        def show(drive: PlannedDrive, frames: int) -> None:
            written[drive.folder] = frames
            bar.update(task, completed=sum(written.values()))

        def end(drive: PlannedDrive, error: BaseException | None) -> None:
            if isinstance(error, OSError) and error.errno in NO_DRIVE_WILL_DO:
                raise error
            if error is None:
                made.append(drive)
            else:
                _complain(f"seed {drive.plan.scenario.seed} ({drive.folder}): {error or type(error).__name__}")
            show(drive, drive.frames)
            bar.update(task, description=f"{len(made)} of {len(drives)} drives")
            check_room(out, made, len(missing) - len(written))

        record_many(missing, show, end)
    return len(drives) - len(made)


def _progress() -> Progress:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    text, percent = TextColumn("{task.description}"), TaskProgressColumn()
    # Drives begin and end without frames: only over several of them is the speed a steady one.
    times = TimeElapsedColumn(), TimeRemainingColumn()
    return Progress(text, BarColumn(), percent, *times, console=Console(stderr=True), speed_estimate_period=900.0)


def _tell(out: Path, contents: list[Content]) -> None:
    kinds = sum((Counter(content.obstacles) for content in contents), Counter[str]())
    parts = Counter(content.split for content in contents)
    typer.echo(
        f"{out}: {len(contents)} drives ({', '.join(f'{count} {part}' for part, count in parts.items())}), "
        f"{sum(sum(content.frames) for content in contents)} frames, "
        f"{', '.join(f'{count} {kind}' for kind, count in sorted(kinds.items()))}, "
        f"{sum(content.bytes for content in contents) / 1e9:.1f} GB"
    )


def _complain(message: str) -> None:
    typer.echo(f"headsup simulate dataset: {message}", err=True)
