"""What of a drive could not be used: counted, and said."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field

LOG = logging.getLogger(__name__)

ALL_SAID = 100
"""So many are said one by one; after them every hundredth, or a loose cable would fill a disk with them in a month."""


@dataclass(slots=True)
class Complaints:
    """What could not be used: a warning each, and their number."""

    count: int = field(default=0, init=False)

    def add(self, message: str) -> None:
        """Log one and count it."""
        self.count += 1
        if self.count <= ALL_SAID:
            LOG.warning("%s", message)
        elif self.count % ALL_SAID == 0:
            LOG.warning("%s (%d of such things so far)", message, self.count)
