"""Two inputs: two frames of one exposure in, their mean out.

fovea run examples/blend --frames 100
"""

from dataclasses import dataclass, replace

import numpy as np
from fovea import Frame, Input, MessageError, Operator, SettingsError


@dataclass(frozen=True, kw_only=True)
class BlendSettings:
    """What a graph may set."""

    share: float = 0.5  # of `left`

    def __post_init__(self) -> None:
        if not 0 <= self.share <= 1:
            raise SettingsError(f"share: must be from 0 to 1, got {self.share}")


class Blend(Operator[BlendSettings, Frame]):
    """Mix two pictures of one size.

    The runtime joins inputs by `seq`: the handler, which is named after both, gets frames of the
    same exposure, whatever the delay of each.
    """

    left = Input(Frame)
    right = Input(Frame)

    def on_left_right(self, left: Frame, right: Frame) -> Frame:
        """Return one frame per pair; raises `MessageError` for pictures of different sizes."""
        for frame in (left, right):
            if frame.pixels.dtype != np.uint8 or frame.packed:
                got = f"{frame.pixels.dtype} of {frame.pixel_format}"
                raise MessageError(f"blend: expected 8-bit pixels, got {got}")
        if left.pixels.shape != right.pixels.shape:
            got = f"{left.pixels.shape} and {right.pixels.shape}"
            raise MessageError(f"blend: expected two pictures of one size, got {got}")
        share = self.settings.share
        mixed = left.pixels * share + right.pixels * (1 - share)
        return replace(left, pixels=np.rint(mixed).astype(np.uint8))
