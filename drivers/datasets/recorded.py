"""A recording as a source: full-resolution frames of an MCAP file in, RGB pictures and truth out.

Another policy, budget or detector thus runs on the same light. The frames must show the whole
field; a graph records them with the sensor's strategy `full`.
"""

import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.source import Annotations
from pipeline.errors import DriverError, FoveaError
from pipeline.messages import Frame, Truth
from pipeline.recording.reader import Exposure, Recording, and_broken

log = logging.getLogger(__name__)


class RecordedFrames:
    """A `FrameSource` over one output of a recording; frames that it lacks are left out.

    Logs a warning when the file is cut or damaged, because frames are then missing at the end.
    """

    def __init__(
        self, *, path: str, output: str = "capture.context", truth: str = "capture.truth"
    ) -> None:
        try:
            self._recording = Recording(Path(path))
        except FoveaError as error:
            raise DriverError(str(error)) from error
        self._path, self._output, self._truth = path, output, truth
        self._frames: list[Exposure] = list(self._recording.messages.get(output, ()))
        if not self._frames:
            known = ", ".join(sorted(self._recording.messages))
            got = f"those of {known}" if known else "no messages"
            raise DriverError(
                f"{path}: expected frames of {output}, got {got}"
                f"{and_broken(self._recording.broken)}"
            )
        first = self._frame(0)
        height, width = first.pixels.shape[:2]
        geometry = first.header.geometry
        field = (geometry.width_px, geometry.height_px)
        if field not in ((0, 0), (width, height)):
            raise DriverError(
                f"{path}: {output}: expected frames of the whole field at full resolution, "
                f"{field[0]}x{field[1]}, got {width}x{height}"
            )
        self.size_px = (width, height)
        self.length: int | None = len(self._frames)
        if self._recording.broken:
            log.warning("%s: %s; it has %d frames", path, self._recording.broken, self.length)
        self.rate_hz = 0.0  # frame by frame: a recording in lockstep has no rate

    def picture(self, index: int) -> NDArray[np.uint8]:
        """Return frame `index` (h, w, 3) RGB; IndexError past the end."""
        pixels = self._frame(index).pixels
        if pixels.shape != (self.size_px[1], self.size_px[0], 3) or pixels.dtype != np.uint8:
            raise DriverError(
                f"{self._path}: {self._output}: frame {index}: expected {self.size_px} RGB "
                f"pixels, got {pixels.dtype}{list(pixels.shape)}"
            )
        return np.asarray(pixels, np.uint8)

    def truth(self, index: int) -> Annotations | None:
        """Return the truth that was recorded for frame `index`; None without one."""
        try:
            found = self._recording.message(self._truth, Truth, self._frames[index])
        except FoveaError as error:
            raise DriverError(str(error)) from error
        if not isinstance(found, Truth):
            return None
        return Annotations(
            boxes=found.boxes, ids=found.ids, labels=found.labels, visibility=found.visibility
        )

    def close(self) -> None:
        """Nothing is held open."""

    def _frame(self, index: int) -> Frame:
        if not 0 <= index < len(self._frames):
            raise IndexError(f"{self._path}: no frame {index} in {len(self._frames)}")
        try:
            found = self._recording.message(self._output, Frame, self._frames[index])
        except FoveaError as error:
            raise DriverError(str(error)) from error
        if not isinstance(found, Frame) or found.pixel_format != "rgb8":
            form = found.pixel_format if isinstance(found, Frame) else "no frame"
            raise DriverError(f"{self._path}: {self._output}: expected rgb8, got {form}")
        return found
