"""`headsup evaluate warned`: how early a driver hears of what lies on the way, where the way bends."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

if TYPE_CHECKING:
    from evaluation.pose_drives import PoseDrive
    from evaluation.warned import OwnWarned, Warned

DRIVES = 6
RECEIVER = "memory of 100 s"
LATEST_S, BEST_S = 2.5, 5.0
"""Below the first an alarm only startles; warnings work best from the second on (`vehicle_client.alerts.STAGES`)."""

OWN_LATEST_S = (1.5, 2.0)
"""What the own LiDAR alone sees, it sees 25 m far: at 50 km/h that is 1.8 s. Within 2 s a car stops from 30 km/h."""


def warned(
    data: Annotated[
        Path | None,
        typer.Option(
            "--data",
            envvar="HEADSUP_DATA",
            help="Folder with any of drive_comma/drive.npz and kitti00; without it only simulated drives.",
        ),
    ] = None,
    drives: Annotated[int, typer.Option("--drives", min=1, max=1_000, help="Simulated town drives.")] = DRIVES,
) -> None:
    """Put an obstacle on every 20 m of a way, tell the client of all, and see when it warns its driver.

    With the bend that the car is on, as `headsup drive` warns, and with a strip straight ahead. Wrong are warnings of
    what the car does not come to within 40 s, most of them across a junction at which it turns. The second table is of
    what the server does not know and the own LiDAR sees 25 m far: on every 10 m one thing in the lane, and one 4 to 8 m
    beside the car's line. Takes two minutes, and another one with the recorded drives.

    Examples:

        headsup evaluate warned --drives 2

        headsup evaluate warned --data ~/data
    """
    from rich.console import Console
    from rich.progress import track

    from evaluation.warned import as_driven, straight_ahead, warned_by_own
    from evaluation.warned import warned as warned_on
    from vehicle_client.sources.frame import SourceError

    progress = Console(stderr=True)
    shown: dict[tuple[str, str], list[Warned]] = {}
    own: dict[tuple[str, str], list[OwnWarned]] = {}
    try:
        recorded = [] if data is None else list(_recorded(data))
    except (SourceError, OSError) as error:
        _refuse(str(error))
    if data is not None and not recorded:
        _refuse(f"neither drive_comma/drive.npz nor kitti00 under {data}; give --data the folder of the data sets")
    jobs = [*enumerate(recorded), *enumerate(_simulated(drives))]
    for seed, drive in track(jobs, "drives", console=progress, transient=True):
        for name, way in (("straight ahead", straight_ahead), ("with the bend", as_driven)):
            shown.setdefault((drive.name, name), []).append(warned_on(drive, way, seed))
            own.setdefault((drive.name, name), []).append(warned_by_own(drive, way, seed))
    _print(shown)
    typer.echo()
    _print_own(own)


def _recorded(data: Path) -> Iterator[PoseDrive]:
    from evaluation.pose_drives import recorded_city_drive, recorded_loop_drive

    if (data / "kitti00").is_dir():
        yield recorded_loop_drive(data, seed=1)
    if (data / "drive_comma" / "drive.npz").exists():
        yield recorded_city_drive(data)


def _simulated(drives: int) -> Iterator[PoseDrive]:
    from dataclasses import replace

    from evaluation.pose_receivers import simulated_drive

    for seed in range(drives):
        yield replace(simulated_drive(RECEIVER, seed), name="simulated, town")


def _print(shown: dict[tuple[str, str], list[Warned]]) -> None:
    import numpy as np

    typer.echo(
        "| drive | warned | obstacles | 5 s before and more | 2.5 s and more | median | 5th percentile | wrong a km |"
    )
    typer.echo("|---|---|---|---|---|---|---|---|")
    for (drive, name), of in shown.items():
        ahead_s = np.concatenate([w.ahead_s for w in of])
        wrong_per_km = 1_000 * sum(w.wrong for w in of) / sum(w.metres for w in of)
        typer.echo(
            f"| {drive} | {name} | {len(ahead_s)} | {(ahead_s >= BEST_S).mean():.1%} | "
            f"{(ahead_s >= LATEST_S).mean():.1%} | {np.median(ahead_s):.1f} s | {np.percentile(ahead_s, 5):.1f} s | "
            f"{wrong_per_km:.1f} |"
        )


def _print_own(own: dict[tuple[str, str], list[OwnWarned]]) -> None:
    import numpy as np

    in_time = " | ".join(f"{least_s} s before, of those seen" for least_s in OWN_LATEST_S)
    typer.echo(f"| drive | warned | {in_time} | median | beside the lane, warned of | shown under 0.5 s |")
    typer.echo("|---|---|---|---|---|---|---|")
    for (drive, name), of in own.items():
        ahead_s, believed_s, beside_s = (
            np.concatenate(columns)
            for columns in zip(*((w.ahead_s, w.believed_s, w.beside_ahead_s) for w in of), strict=True)
        )
        shares = [f"{(ahead_s >= least).sum()}/{(believed_s >= least).sum()}" for least in OWN_LATEST_S]
        typer.echo(
            f"| {drive} | {name} | {shares[0]} | {shares[1]} | {np.median(ahead_s):.1f} s | "
            f"{(beside_s > 0).sum()}/{len(beside_s)} | {sum(w.flickers for w in of)} |"
        )


def _refuse(message: str) -> NoReturn:
    typer.secho(f"headsup evaluate warned: {message}", err=True, fg=typer.colors.RED)
    raise typer.Exit(1)
