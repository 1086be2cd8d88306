"""Stateful: a frame in, its difference from the background out; the background survives a swap.

fovea run examples/motion
fovea swap motion motion --set rate=0.2        (in another terminal)
"""

from dataclasses import dataclass, replace

import numpy as np
from fovea import Frame, Header, Input, MessageError, Operator, SettingsError
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class MotionSettings:
    """What a graph may set."""

    rate: float = 0.05  # weight of a new frame in the background

    def __post_init__(self) -> None:
        if not 0 < self.rate <= 1:
            raise SettingsError(f"rate: must be above 0 and at most 1, got {self.rate}")


@dataclass(frozen=True, kw_only=True)
class Background:
    """The state for a successor: one dataclass of plain values and arrays."""

    mean: NDArray[np.float32]  # (h, w, 3), empty before the first frame
    frames: int


EMPTY = Background(mean=np.zeros((0, 0, 3), np.float32), frames=0)


class Motion(Operator[MotionSettings, Frame]):
    """Keep a running mean of the frames; send the absolute difference of each frame from it."""

    frame = Input(Frame, keep="every")  # a missed frame would change the background

    def open(self) -> None:
        """Start without a background."""
        self._background = EMPTY

    def on_stream(self, header: Header) -> None:
        """Forget the background of another stream."""
        self._background = EMPTY

    def on_frame(self, frame: Frame) -> Frame:
        """Return the difference of a frame from the background.

        Raises `MessageError` for pixels of more than 8 bits.
        """
        if frame.pixels.dtype != np.uint8 or frame.packed:
            raise MessageError(
                f"motion: expected 8-bit pixels, got {frame.pixels.dtype} of {frame.pixel_format}"
            )
        mean = self._background.mean
        if mean.shape != frame.pixels.shape:
            mean = frame.pixels.astype(np.float32)
        difference = np.abs(frame.pixels - mean)
        mean = mean + np.float32(self.settings.rate) * (frame.pixels - mean)
        self._background = Background(mean=mean, frames=self._background.frames + 1)
        return replace(frame, pixels=difference.astype(np.uint8))

    def state(self) -> Background:
        """Return the background for a successor; called between two frames."""
        return self._background

    def restore(self, state: Background) -> None:
        """Take over the background of another instance; called after `open`."""
        self._background = state
