"""Stateless: a frame in, a brighter frame out.

fovea run examples/brighten --frames 100
"""

from dataclasses import dataclass, replace

import numpy as np
from fovea import Frame, Input, MessageError, Operator, SettingsError


@dataclass(frozen=True, kw_only=True)
class BrightenSettings:
    """What a graph may set; types are checked before anything runs, ranges here."""

    gain: float = 1.5

    def __post_init__(self) -> None:
        if self.gain < 0:
            raise SettingsError(f"gain: must be at least 0, got {self.gain}")


class Brighten(Operator[BrightenSettings, Frame]):
    """Multiply every pixel; keep header and window, by which readers join and locate the frame."""

    frame = Input(Frame, keep="latest")  # a late frame is dropped, and counted

    def on_frame(self, frame: Frame) -> Frame:
        """Return one frame per frame; raises `MessageError` for pixels of more than 8 bits."""
        if frame.pixels.dtype != np.uint8 or frame.packed:
            raise MessageError(
                f"brighten: expected 8-bit pixels, got {frame.pixels.dtype} of {frame.pixel_format}"
            )
        bright = np.minimum(frame.pixels * self.settings.gain, 255)
        return replace(frame, pixels=bright.astype(np.uint8))
