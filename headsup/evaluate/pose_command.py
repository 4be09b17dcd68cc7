"""`headsup evaluate pose`: how right the vehicle's pose is, and how honest about it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from headsup.evaluate.outputs import make_ready

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from evaluation.odometry_accuracy import Deskewed, MatchedDrive
    from evaluation.pose_accuracy import PoseFigures, PoseTrace
    from evaluation.pose_drives import PoseDrive

MATCHED_WAY_M = 150.0
MINUTES_A_SEED = 3
"""Of the recorded city drive with drawn errors: as long as a simulated drive."""
CITY, LOOPS = "recorded city, as stamped", "recorded loops"


def pose(
    data: Annotated[
        Path,
        typer.Option(
            "--data", envvar="HEADSUP_DATA", help="Folder with any of drive_comma/drive.npz, kitti00 and kitti_drive."
        ),
    ],
    picture: Annotated[Path | None, typer.Option("--picture", help="Write a PNG with errors and tracks.")] = None,
    seeds: Annotated[int, typer.Option("--seeds", min=1, max=1_000, help="Drives of 3 minutes a receiver.")] = 20,
    sweeps: Annotated[bool, typer.Option("--sweeps/--no-sweeps", help="Also match sweeps and take motion out.")] = True,
) -> None:
    """Hold poses against recorded and simulated truth: errors, the 95 % ellipse, heading, smoothness.

    On a recorded city drive with its live fixes, on the same with the errors of its fixes drawn many times, on recorded
    loops with fixes once a second, and on simulated town drives whose receivers err in known ways; then odometry from
    sweeps alone, and points brought to one moment. Takes about a quarter of an hour, most of it for drives with drawn
    errors.

    Examples:

        headsup evaluate pose --data ~/data --picture out/pose.png

        headsup evaluate pose --data ~/data --seeds 2 --no-sweeps
    """
    from rich.console import Console
    from rich.progress import track

    from evaluation.odometry_accuracy import MANOEUVRES, deskewed
    from evaluation.pose_accuracy import figures, traced
    from evaluation.pose_picture import draw_pose
    from evaluation.pose_receivers import RECEIVERS, REDRAWN, redrawn, simulated_drive
    from vehicle_client.sources.frame import SourceError

    try:
        make_ready(picture)
        recorded = list(_recorded(data))
    except (SourceError, OSError) as error:
        _refuse(str(error))
    if not recorded:
        _refuse(f"neither drive_comma/drive.npz nor kitti00 under {data}; give --data the folder of the data sets")
    progress = Console(stderr=True)
    shown: dict[str, PoseFigures] = {}
    traces: dict[str, PoseTrace] = {}
    for drive in track(recorded, "recorded", console=progress, transient=True):
        traces[drive.name] = traced(drive)
        shown[drive.name] = figures([traces[drive.name]])
    city = next((drive for drive in recorded if drive.name == CITY), None)
    minutes = MINUTES_A_SEED * seeds
    drawn = {} if city is None else _seeded("drawn errors", REDRAWN, minutes, partial(redrawn, city), progress)
    simulated = _seeded("simulated", RECEIVERS, seeds, simulated_drive, progress)
    shown |= {f"city, drawn errors, {name}": figures(of) for name, of in drawn.items()}
    shown |= {f"simulated, {name}": figures(of) for name, of in simulated.items()}
    console = Console(width=150)
    console.print(_pose_table(shown))
    if drawn:
        console.print(_minutes_table(drawn))
    if sweeps:
        turns = [deskewed(manoeuvre, seed=1) for manoeuvre in track(MANOEUVRES, "sweeps", console=progress)]
        console.print(_deskew_table(turns))
        console.print(_matching_table(list(_matched(data))))
    if picture is not None:
        known = {drive.name: (drive, traces[drive.name]) for drive in recorded}
        draw_pose(picture, known.get(CITY), known.get(LOOPS), simulated, deskewed(MANOEUVRES[-1], seed=1))
        typer.echo(picture)


def _recorded(data: Path) -> Iterator[PoseDrive]:
    """The recorded drives that are there; the city drive three times: as stamped, without steering, and corrected."""
    from dataclasses import replace

    from evaluation.pose_drives import RECEIVER_DELAY_S, recorded_city_drive, recorded_loop_drive

    if (data / "drive_comma" / "drive.npz").exists():
        yield replace(recorded_city_drive(data), name=CITY)
        yield replace(recorded_city_drive(data, steering=False), name="recorded city, no steering")
        yield replace(
            recorded_city_drive(data, known_delay_s=RECEIVER_DELAY_S), name="recorded city, 95 ms delay known"
        )
    if (data / "kitti00").is_dir():
        yield replace(recorded_loop_drive(data, seed=1), name=LOOPS)


def _seeded(
    title: str, names: Collection[str], seeds: int, drive: Callable[[str, int], PoseDrive], progress: Console
) -> dict[str, list[PoseTrace]]:
    """A trace of each seed's drive with each receiver."""
    from rich.progress import track

    from evaluation.pose_accuracy import traced

    jobs = [(name, seed) for name in names for seed in range(seeds)]
    traces: dict[str, list[PoseTrace]] = {name: [] for name in names}
    for name, seed in track(jobs, title, console=progress, transient=True):
        traces[name].append(traced(drive(name, seed)))
    return traces


def _matched(data: Path) -> Iterator[MatchedDrive]:
    from evaluation.odometry_accuracy import matched, recorded_sweeps, simulated_sweeps
    from simulator.mesh import pose as mounted
    from simulator.sensors.lidar_presets import hdl64e

    mounting = mounted(0.0, 0.0, hdl64e().height_m)
    for speed, times in ((14.0, True), (14.0, False), (25.0, True)):
        name = f"simulated street, {speed:.0f} m/s, points {'with' if times else 'without'} times"
        yield matched(name, simulated_sweeps(MATCHED_WAY_M, speed, 1, times=times), mounting)
    paths = sorted(data.glob("kitti_drive/*.laz"))
    if paths:
        yield matched("recorded drive (kitti_drive)", recorded_sweeps(paths), mounting)


def _pose_table(shown: dict[str, PoseFigures]) -> Table:
    from rich.table import Table

    table = Table(title="Poses: horizontal error against the truth, at moments with a pose")
    columns = (
        "drive",
        "with pose",
        "fixes, median",
        "median",
        "95 %",
        "in ellipse",
        "heading rms",
        "in 2 sd",
        "jump at 50 m",
    )
    for name in columns:
        table.add_column(name, justify="left" if name == "drive" else "right")
    for name, of in shown.items():
        table.add_row(
            name,
            f"{of.with_pose:.1%}",
            f"{of.raw_median_m:.2f} m",
            f"{of.median_m:.2f} m",
            f"{of.p95_m:.2f} m",
            f"{of.coverage:.1%}",
            f"{of.heading_rms_deg:.2f} deg",
            f"{of.heading_within_2_sd:.1%}",
            f"{of.jump_p99_m:.2f} m",
        )
    return table


def _minutes_table(drawn: dict[str, list[PoseTrace]]) -> Table:
    from rich.table import Table

    from evaluation.pose_accuracy import ASKED_SHARE, counted

    least, most = (round(100 * share) for share in ASKED_SHARE)
    table = Table(title="The recorded city drive with drawn errors: minutes by their share in the ellipse")
    for name in ("errors", "minutes", "100 %", f"above {most} %", f"{least} to {most} %", f"below {least} %"):
        table.add_column(name, justify="left" if name == "errors" else "right")
    for name, traces in drawn.items():
        of = counted(traces)
        table.add_row(name, *(str(value) for value in (len(traces), of.always, of.above, of.within, of.below)))
    return table


def _deskew_table(turns: list[Deskewed]) -> Table:
    import numpy as np
    from rich.table import Table

    table = Table(title="Points nearer than 30 m of a rolling HDL-64E, distance from where they were at the stamp")
    for name in ("manoeuvre", "as measured, mean", "95 %", "motion taken out, mean", "95 %"):
        table.add_column(name, justify="left" if name == "manoeuvre" else "right")
    for turn in turns:
        errors = (turn.raw_error_m, turn.error_m)
        figures = [f"{value * 100:.1f} cm" for e in errors for value in (e.mean(), np.percentile(e, 95))]
        table.add_row(turn.manoeuvre.name, *figures)
    return table


def _matching_table(drives: list[MatchedDrive]) -> Table:
    import numpy as np
    from rich.table import Table

    table = Table(title="Odometry from sweeps alone (KISS-ICP)")
    for name in ("drive", "way", "drift / 100 m", "turn / 100 m", "step change, rms", "a sweep, median", "95 %"):
        table.add_column(name, justify="left" if name == "drive" else "right")
    for drive in drives:
        table.add_row(
            drive.name,
            f"{drive.length_m:.1f} m",
            "-" if drive.truth is None else f"{drive.drift_percent:.2f} m",
            "-" if drive.truth is None else f"{drive.turn_deg_per_100_m:.2f} deg",
            f"{drive.roughness_m * 100:.1f} cm",
            *(f"{value * 1000:.0f} ms" for value in np.percentile(drive.seconds, [50, 95])),
        )
    return table


def _refuse(message: str) -> NoReturn:
    typer.secho(f"headsup evaluate pose: {message}", err=True, fg=typer.colors.RED)
    raise typer.Exit(1)
