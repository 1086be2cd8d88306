"""Memory to be filled from one stream of the board."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.usb.errors import LinkError


@dataclass(eq=False)
class Part:
    """Memory to be filled by bulk reads, as far as the board sends before a short packet."""

    stream: int  # index of the bulk IN end point
    memory: NDArray[np.uint8]  # (n,) contiguous
    received: int = 0  # bytes
    submitted: int = 0  # bytes, of the reads that have returned or are in flight
    short: bool = False  # a short packet ended it before it was full
    failure: LinkError | None = None  # of one of its reads

    def __len__(self) -> int:
        return len(self.memory)

    @property
    def full(self) -> bool:
        """Whether nothing is missing."""
        return self.received == len(self.memory)

    @property
    def over(self) -> bool:
        """Whether nothing more will come."""
        return self.full or self.short
