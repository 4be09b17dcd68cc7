"""What can go wrong with a CARLA server."""

from __future__ import annotations


class CarlaBridgeError(RuntimeError):
    """A recording cannot be made; the message says what to do."""
