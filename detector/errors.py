"""What the detector refuses."""

from __future__ import annotations


class DetectorError(ValueError):
    """The input cannot be used; the message says why and what to do."""
