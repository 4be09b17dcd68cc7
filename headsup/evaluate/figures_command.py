"""`headsup evaluate figures`: the paper's result figures drawn anew."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

Drawing = tuple[str, Callable[[Path], None]]


def evaluate_figures(
    out: Annotated[Path, typer.Option("--out", help="Folder for the PNG files; made if missing.")],
    data: Annotated[
        Path | None,
        typer.Option(
            "--data",
            envvar="HEADSUP_DATA",
            help="Folder with any of potholes, stereo, pothole_rgbd and kitti_sequence.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", help="For the composed and simulated scenes.")] = 1,
) -> None:
    """Draw the figures: scans at four densities, stereo frames, LiDAR frames, and a pothole's surface.

    Two come from the simulator and need no data: lidar_simulated.png and surface_simulated.png. For what is found in
    DIR there are more: scan.png and scan_noise.png (potholes/*.ply), stereo.png (stereo/dataset*/NN_disparity.png),
    surface_camera.png (pothole_rgbd/*.ply) and lidar_kitti.png (kitti_sequence/velodyne/*.bin).

    Examples:

        headsup evaluate figures --out out/figures

        headsup evaluate figures --data data --out out/figures
    """
    from rich.console import Console
    from rich.progress import track

    if data is not None and not data.is_dir():
        _refuse(f"{data}: no such folder; give --data the folder of the data sets, or leave it out")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        _refuse(f"{out}: cannot be made: {error.strerror}")
    drawings = _simulated(seed) + (_from_data(data, seed) if data else [])
    for name, draw in track(drawings, description="drawing", console=Console(stderr=True), transient=True):
        try:
            draw(out / name)
        except (OSError, ValueError) as error:
            _refuse(f"{name}: {error}")
        typer.echo(out / name)


def _simulated(seed: int) -> list[Drawing]:
    from evaluation.figures_lidar import draw_lidar, simulated_frame
    from evaluation.figures_surface import draw_surface, simulated_survey

    return [
        ("lidar_simulated.png", lambda path: draw_lidar(path, simulated_frame())),
        ("surface_simulated.png", lambda path: draw_surface(path, simulated_survey(seed))),
    ]


def _from_data(data: Path, seed: int) -> list[Drawing]:
    """What the first file of each kind gives."""
    drawings: list[Drawing] = []
    for scan in sorted((data / "potholes").glob("*.ply"))[:1]:
        drawings.append(("scan.png", partial(_draw_scan, scan, 0.0, seed)))
        drawings.append(("scan_noise.png", partial(_draw_scan, scan, 0.5, seed)))
    if list(data.glob("stereo/dataset*/*_disparity.png")):
        drawings.append(("stereo.png", partial(_draw_stereo, data)))
    for cloud in sorted((data / "pothole_rgbd").glob("*.ply"))[:1]:
        drawings.append(("surface_camera.png", partial(_draw_camera, cloud)))
    for sweep in sorted((data / "kitti_sequence" / "velodyne").glob("*.bin"))[:1]:
        drawings.append(("lidar_kitti.png", partial(_draw_kitti, sweep)))
    return drawings


def _draw_scan(scan: Path, noise_mm: float, seed: int, path: Path) -> None:
    from evaluation.composed_scan import read_mould
    from evaluation.figures_scan import draw_scan

    draw_scan(path, read_mould(scan), scan.stem, noise_mm, seed)


def _draw_stereo(data: Path, path: Path) -> None:
    from evaluation.figures_stereo import draw_stereo, first_frames

    draw_stereo(path, first_frames(data))


def _draw_camera(cloud: Path, path: Path) -> None:
    from evaluation.depth_camera import read_camera_points, to_road_axes
    from evaluation.figures_surface import Survey, draw_surface

    draw_surface(path, Survey(to_road_axes(read_camera_points(cloud)), f"depth camera, {cloud.stem}"))


def _draw_kitti(sweep: Path, path: Path) -> None:
    from evaluation.figures_lidar import draw_lidar, kitti_frame

    draw_lidar(path, kitti_frame(sweep))


def _refuse(message: str) -> None:
    typer.secho(f"headsup evaluate figures: {message}", err=True, fg=typer.colors.RED)
    raise typer.Exit(1)
