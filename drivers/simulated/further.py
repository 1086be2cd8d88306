"""Windows 2 to K of the simulated sensor: commands in, frames and counts of them out.

A window that equals an earlier one of the same exposure is read once: the later port sends a frame
without pixels. Windows that overlap otherwise are read each for itself, and counted so.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.commands import Commanded
from drivers.readout import roi_frame
from drivers.sensor import EMPTY_WINDOW, FURTHER
from drivers.simulated.readout import Readout
from drivers.simulated.windows import Picture
from pipeline.contract import Loan
from pipeline.messages import Frame, Header


class FurtherWindows:
    """Which of the windows behind the first are read, and how often."""

    def __init__(self, rois: int) -> None:
        self._outputs = FURTHER[: rois - 1]
        self._counts: Counter[str] = Counter()

    def memory(self, loan: Loan, readout: Readout, roi_px: tuple[int, int]) -> list[NDArray[Any]]:
        """Memory for each window, lent before the command is looked up; `PoolExhausted` passes."""
        shape = readout.shape(roi_px)
        return [loan(output, shape, readout.dtype) for output in self._outputs]

    def effective(self, aims: Sequence[Commanded]) -> list[Commanded]:
        """Return the K windows of an exposure with duplicates emptied, and count 2 to K."""
        found, seen = [aims[0]], {aims[0].window}
        for aim in aims[1:]:
            fate = "read"
            if aim.window == EMPTY_WINDOW:
                fate = "not_commanded"
            elif aim.window in seen:
                fate = "duplicate"
            self._counts[fate] += 1
            seen.add(aim.window)
            found.append(aim if fate == "read" else replace(aim, window=EMPTY_WINDOW))
        return found

    def summary(self) -> Mapping[str, Any]:
        """Windows by what became of them; nothing for a sensor that reads one."""
        return {"further_windows": dict(self._counts)} if self._outputs else {}


def read_further(
    header: Header,
    picture: Picture,
    aims: Sequence[Commanded],
    lent: Sequence[NDArray[Any]],
    readout: Readout,
    roi_px: tuple[int, int],
) -> tuple[Frame, ...]:
    """Read windows 2 to K into the memory lent for them; one that is not read has no pixels."""
    frames = []
    for port, (aim, memory) in enumerate(zip(aims, lent, strict=True), 2):
        pixels = memory
        if aim.window == EMPTY_WINDOW:
            pixels = np.empty(readout.shape((0, 0)), readout.dtype)
        else:
            readout.read(picture, aim.window, pixels, seq=header.seq, port=port)
        form = readout.form_of(aim.window, roi_px).name
        frames.append(roi_frame(header, pixels, aim, form))
    return tuple(frames)
