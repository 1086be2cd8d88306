"""Pictures that show their own number, so that a test knows which frame it was given."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

MARK_PX = 16  # side of the blocks that hold the frame's number in binary
MARKS = 16


def picture(index: int, size_px: tuple[int, int] = (320, 192)) -> NDArray[np.uint8]:
    """Frame `index` (h, w, 3) RGB: its number as white and black blocks on a coloured ramp."""
    width, height = size_px
    x = np.linspace(0, 200, width, dtype=np.float32)[None, :].repeat(height, 0)
    shown = np.dstack([x, 120 - x / 2, np.full_like(x, 40)]).astype(np.uint8)
    for bit in range(MARKS):
        shown[:MARK_PX, bit * MARK_PX : (bit + 1) * MARK_PX] = 255 * (index >> bit & 1)
    return shown


def number_of(shown: NDArray[Any], scale: float = 1.0) -> int:
    """The number in a picture of the whole field, at any scale."""
    side = MARK_PX * scale
    row = round(side / 2)
    return sum(
        1 << bit
        for bit in range(MARKS)
        if shown[row, round((bit + 0.5) * side)].astype(int).sum() > 3 * 128
    )
