"""Stateless: a frame in, the same frame brighter out.

fovea run examples/brighten --frames 100
"""

from dataclasses import dataclass, replace

import numpy as np
from fovea import Frame, Input, Operator, SettingsError
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class BrightenSettings:
    """What a graph may set; types are checked before anything runs, ranges here."""

    gain: float = 1.5

    def __post_init__(self) -> None:
        if self.gain < 0:
            raise SettingsError(f"gain: must be at least 0, got {self.gain}")


class Brighten(Operator[BrightenSettings, Frame]):
    """Multiply every pixel; keep header and window, by which others join and place the frame."""

    frame = Input(Frame, keep="latest")  # a late frame is dropped, and counted

    def on_frame(self, frame: Frame) -> Frame:
        """Answer each frame with one."""
        return replace(frame, pixels=brightened(frame.pixels, self.settings.gain))


def brightened(pixels: NDArray[np.uint8] | NDArray[np.uint16], gain: float) -> NDArray[np.uint8]:
    """8-bit pixels times a gain, the brightest cut off at 255.

    >>> brightened(np.array([[10, 200]], np.uint8), 2.0)
    array([[ 20, 255]], dtype=uint8)
    """
    bright: NDArray[np.uint8] = np.minimum(pixels * gain, 255).astype(np.uint8)
    return bright
