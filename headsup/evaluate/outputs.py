"""Where results go: found out before long work, not after it."""

from __future__ import annotations

from pathlib import Path


def make_ready(file: Path | None) -> None:
    """Make a file that can be written, and its folder; OSError if that cannot be. Nothing is asked for with None."""
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.open("a").close()
