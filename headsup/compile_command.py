"""`headsup compile`: the inner loops compiled before the first drive needs them."""

from __future__ import annotations

import typer


def compile_loops() -> None:
    """Compile what runs inside the detector and the simulator for this machine.

    Takes up to a minute, once for each version, and a few seconds when all is there. Without it the first drive does
    the same on its way, and misses the road meanwhile. What is made is kept beside the program, or in NUMBA_CACHE_DIR.

    Examples:

        headsup compile

        NUMBA_CACHE_DIR=/var/cache/headsup headsup compile
    """
    from rich.console import Console

    from headsup.first_uses import compile_all

    try:
        with Console(stderr=True).status("compiling for this machine, up to a minute ..."):
            for name in compile_all():
                typer.echo(f"{name}: ready")
    except (OSError, RuntimeError) as error:
        typer.echo(f"headsup compile: {error}; drives compile on their way", err=True)
        raise typer.Exit(1) from None
    except KeyboardInterrupt:
        typer.echo("headsup compile: interrupted; drives compile on their way", err=True)
        raise typer.Exit(130) from None
