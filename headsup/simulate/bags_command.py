"""`headsup simulate bags`: two cars on one street as ROS 2 bags, to try `headsup drive` on."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from headsup.demo.simulated import SimulatedSource


def bags(out: Annotated[Path, typer.Option("--out", help="A new or empty folder for the bags.")]) -> None:
    """Write two drives along one street as ROS 2 bags, with the calibration of both cars: first, second and car.toml.

    The first car passes two potholes, a bump and a broken pallet; the second one comes towards them and is still too
    far away to see any. Each bag holds a LiDAR's sweeps (PointCloud2), fixes, headings, odometry and
    transforms. Takes ten seconds and 80 MB; docs/vehicle.md goes on from here.

    Example:

        headsup simulate bags --out bags
    """
    from headsup.simulate.street_bags import CAR_TOML, first_car, second_car, street
    from simulator.world import World

    try:
        out.mkdir(parents=True, exist_ok=True)
        if any(out.iterdir()):
            typer.echo(f"headsup simulate bags: {out}: is not empty; give a new or empty folder", err=True)
            raise typer.Exit(1)
        world = World(street())
        with TemporaryDirectory(dir=out, prefix="unfinished-") as unfinished:
            made = Path(unfinished)
            for name, car in (("first", first_car(world)), ("second", second_car(world))):
                _write(made / name, car)
            (made / "car.toml").write_text(CAR_TOML, encoding="utf-8")
            for file in sorted(made.iterdir()):
                file.rename(out / file.name)
    except (OSError, sqlite3.Error) as error:
        said = str(error) if isinstance(error, sqlite3.Error) else error.strerror or error
        typer.echo(f"headsup simulate bags: {out}: {said}; give --out a folder where 80 MB can be written", err=True)
        raise typer.Exit(1) from None
    except KeyboardInterrupt:
        typer.echo("headsup simulate bags: interrupted; no bags were written", err=True)
        raise typer.Exit(130) from None
    typer.echo(f"{out}: first and second, two ROS 2 bags of one street, and car.toml")


def _write(bag: Path, car: SimulatedSource) -> None:
    from rich.console import Console
    from rich.progress import track

    from headsup.demo.simulated import calibration
    from vehicle_client.recording.ros_bag import write_bag

    frames = track(car, bag.name, len(car), console=Console(stderr=True), transient=True)
    write_bag(bag, frames, calibration().vehicle_from_sensor)
