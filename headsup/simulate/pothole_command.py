"""`headsup simulate pothole`: potholes, bumps, speed humps and debris as meshes with labels and exact sizes."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

if TYPE_CHECKING:
    from collections.abc import Mapping

    from simulator.samples.sample import Sample, Wishes


class Kind(StrEnum):
    """Families of obstacles; mixed takes all of them in turn."""

    POTHOLE = "pothole"
    BUMP = "bump"
    HUMP = "hump"
    DEBRIS = "debris"
    MIXED = "mixed"


class Profile(StrEnum):
    """Sections of speed humps."""

    SINUSOIDAL = "sinusoidal"
    ROUND_TOP = "round-top"
    FLAT_TOP = "flat-top"


class Shape(StrEnum):
    """Debris."""

    PALLET = "pallet"
    TYRE = "tyre"
    TREAD = "tread"
    CARTON = "carton"
    ROCK = "rock"
    ROCKS = "rocks"
    TIMBER = "timber"
    EXHAUST = "exhaust"
    CONE = "cone"


SIZES, PATCH = frozenset({"--length", "--width"}), frozenset({"--patch-side"})
MEANT_FOR = {
    Kind.POTHOLE: SIZES
    | PATCH
    | {"--depth", "--wall", "--lobes", "--water", "--repaired", "--scan", "--true-size", "--grow", "--fill"},
    Kind.BUMP: SIZES | PATCH | {"--height", "--grow"},
    Kind.HUMP: SIZES | PATCH | {"--height", "--profile"},
    Kind.DEBRIS: SIZES | {"--height", "--shape"},
    Kind.MIXED: frozenset[str](),
}
"""Options of each kind; the others would be without effect."""

NOT_WITH_SCAN = frozenset({"--width", "--wall", "--lobes", "--repaired"})
NOT_WITH_REPAIRED = frozenset({"--depth", "--wall", "--water", "--grow", "--fill"})
NOT_WITH_TRUE_SIZE = frozenset({"--length", "--depth"})


@dataclass(frozen=True, slots=True)
class _Plan:
    """Samples to make, each from its index."""

    kind: Kind
    seed: int
    count: int
    wishes: Wishes

    def name(self, index: int) -> str:
        from simulator.samples.gallery import gallery_name
        from simulator.samples.sample import SampleKind, sample_name

        if self.kind is Kind.MIXED:
            return gallery_name(index, self.seed)
        return sample_name(SampleKind(self.kind.value), self.seed + index)

    def sample(self, index: int) -> Sample:
        from simulator.samples.gallery import gallery_sample
        from simulator.samples.sample import SampleKind, make_sample

        if self.kind is Kind.MIXED:
            return gallery_sample(index, self.seed)
        return make_sample(SampleKind(self.kind.value), self.seed + index, self.wishes)


def pothole(
    out: Annotated[Path, typer.Option("--out", help="Folder for the files; made if missing.")],
    kind: Annotated[Kind, typer.Option("--kind", help="What to make; mixed: 24 sorts in turn.")] = Kind.POTHOLE,
    shape: Annotated[Shape | None, typer.Option("--shape", help="Of debris; by default from the seed.")] = None,
    profile: Annotated[Profile | None, typer.Option("--profile", help="Of a hump; by default from the seed.")] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the first sample; the next ones count on.")] = 1,
    count: Annotated[int, typer.Option("--count", min=1, max=10_000, help="Samples to make.")] = 1,
    length: Annotated[float | None, typer.Option("--length", help="Metres along x; by default from the seed.")] = None,
    width: Annotated[float | None, typer.Option("--width", help="Metres along y; by default from the seed.")] = None,
    depth: Annotated[float | None, typer.Option("--depth", help="Metres, of a pothole.")] = None,
    height: Annotated[float | None, typer.Option("--height", help="Metres, of what rises.")] = None,
    wall: Annotated[float | None, typer.Option("--wall", help="Width of a pothole's sloped wall, metres.")] = None,
    lobes: Annotated[int | None, typer.Option("--lobes", help="Holes that make up one pothole, 1 to 5.")] = None,
    water: Annotated[float | None, typer.Option("--water", help="Share of the depth under water, 0 to 1.")] = None,
    repaired: Annotated[bool, typer.Option("--repaired", help="A patch instead of a hole: no obstacle.")] = False,
    scan: Annotated[
        Path | None, typer.Option("--scan", help="Mould of a real pothole: binary PLY, millimetres, convex.")
    ] = None,
    true_size: Annotated[
        bool, typer.Option("--true-size", help="The scan as it is, not scaled to a road's pothole.")
    ] = False,
    grow: Annotated[float | None, typer.Option("--grow", help="Per cent more area, and as much more depth.")] = None,
    fill: Annotated[float | None, typer.Option("--fill", help="Share of the depth filled with gravel, 0 to 1.")] = None,
    patch_side: Annotated[
        float | None, typer.Option("--patch-side", help="Side of the square road patch, metres; by default it fits.")
    ] = None,
    sheet: Annotated[
        bool, typer.Option("--sheet", help="Also sheet.png: the first 24 samples as a camera sees them.")
    ] = False,
) -> None:
    """Make potholes, bumps, speed humps and debris: meshes with labels, textured road patches, and exact sizes.

    For each sample writes NAME.ply (binary, a label and a material for each vertex), NAME.obj with NAME.mtl and
    NAME.png (the same mesh: a closed piece of road with its border at z = 0; debris has one colour and no PNG), and
    NAME.json (kind, sizes, volume, footprint, parameters, conventions). Metres, z up. The same options give the same
    bytes; files that exist are not overwritten.

    Examples:

        headsup simulate pothole --count 100 --out out/potholes

        headsup simulate pothole --length 0.8 --width 0.6 --depth 0.09 --lobes 2 --water 0.5 --out out/wet

        headsup simulate pothole --scan mould.ply --length 0.9 --grow 20 --patch-side 4 --out out/scan

        headsup simulate pothole --kind debris --shape tyre --out out/tyre

        headsup simulate pothole --kind mixed --count 24 --sheet --out out/sheet
    """
    from simulator.samples.scan import ScanError

    given = {
        "--shape": shape,
        "--profile": profile,
        "--length": length,
        "--width": width,
        "--depth": depth,
        "--height": height,
        "--wall": wall,
        "--lobes": lobes,
        "--water": water,
        "--repaired": repaired or None,
        "--scan": scan,
        "--true-size": true_size or None,
        "--grow": grow,
        "--fill": fill,
        "--patch-side": patch_side,
    }
    options = {name: value for name, value in given.items() if value is not None}
    try:
        _refuse_what_does_not_fit(kind, set(options), count)
        _write(
            _Plan(kind, seed, count, _wishes({name: options[name] for name in options.keys() - PATCH})),
            out,
            patch_side,
            sheet=sheet,
        )
    except OSError as error:
        _fail(f"{error.filename or out}: {error.strerror or error}")
    except (ScanError, ValueError) as error:
        _fail(str(error))
    except KeyboardInterrupt:
        typer.echo("headsup simulate pothole: interrupted; the last sample may lack files", err=True)
        raise typer.Exit(130) from None
    typer.echo(f"{out}: {count} {'sample' if count == 1 else 'samples'}")


def _refuse_what_does_not_fit(kind: Kind, options: set[str], count: int) -> None:
    strange = sorted(options - MEANT_FOR[kind])
    if strange:
        fitting = ", ".join(other for other in MEANT_FOR if strange[0] in MEANT_FOR[other])
        raise ValueError(f"{strange[0]} is not for --kind {kind} (it is for: {fitting})")
    if "--repaired" in options and options & NOT_WITH_REPAIRED:
        raise ValueError(f"{min(options & NOT_WITH_REPAIRED)} would change nothing: a repair is level with the road")
    if "--scan" not in options:
        if "--true-size" in options:
            raise ValueError("--true-size needs --scan FILE")
        return
    wrong = sorted(options & (NOT_WITH_SCAN | (NOT_WITH_TRUE_SIZE if "--true-size" in options else frozenset())))
    if wrong:
        raise ValueError(f"{wrong[0]} cannot be chosen here: the scan has its own")
    if count > 1:
        raise ValueError("--scan makes one sample: leave out --count")


def _wishes(options: Mapping[str, object]) -> Wishes:
    from simulator.samples.sample import Wishes
    from simulator.shapes.debris import DebrisKind
    from simulator.shapes.hump import HumpProfile

    names = {"--depth": "relief_m", "--height": "relief_m", "--true-size": "true_size", "--grow": "grow_percent"}
    names |= {"--length": "length_m", "--width": "width_m", "--wall": "wall_m"}
    wishes: dict[str, object] = {
        names.get(option, option.removeprefix("--")): value for option, value in options.items()
    }
    if "profile" in wishes:
        wishes["profile"] = HumpProfile(str(wishes["profile"]))
    if "shape" in wishes:
        wishes["shape"] = DebrisKind(str(wishes["shape"]))
    return Wishes(**wishes)  # type: ignore[arg-type]  # typer has checked the types


def _write(plan: _Plan, out: Path, patch_side: float | None, *, sheet: bool) -> None:
    from rich.console import Console
    from rich.progress import track

    from simulator.samples.picture_sheet import SHEET_SAMPLES, draw_sheet
    from simulator.samples.sample_files import write_sample

    names = [plan.name(index) for index in range(plan.count)] + ["sheet"] * sheet
    existing = {path.stem for path in out.iterdir()} if out.exists() else set[str]()
    taken = [name for name in names if name in existing]
    if taken:
        raise ValueError(f"{out / taken[0]}.* exists: choose another --out or --seed")
    console = Console(stderr=True)
    shown: list[Sample] = []
    for index in track(range(plan.count), "writing", console=console, transient=True):
        sample = plan.sample(index)
        write_sample(sample, out, patch_side)
        shown += [sample] if sheet and len(shown) < SHEET_SAMPLES else []
    if sheet:
        with console.status("drawing"):
            (out / "sheet.png").write_bytes(draw_sheet(shown))


def _fail(message: str) -> NoReturn:
    typer.echo(f"headsup simulate pothole: {message}", err=True)
    raise typer.Exit(1)
