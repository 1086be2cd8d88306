"""Pictures that are read by windows: a source and a frame number in, averaged regions out."""

from dataclasses import dataclass
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from drivers.commands import Window
from drivers.readout import average
from drivers.simulated.checked import checked_picture
from drivers.source import FrameSource, WindowSource

# of the whole pitch at 7680x4320 as 1358x764, a rest of 1.1 keeps 73 % of the sharpness, 2.8 96 %
LEAST_REST = 2.5


@dataclass(frozen=True, kw_only=True)
class WindowedPicture:
    """One picture of a source, made only where it is looked at."""

    source: WindowSource
    index: int

    def read(self, window: Window, out: NDArray[np.uint8]) -> None:
        """Fill `out` (h, w, 3) with area means of a window."""
        left, top, right, bottom = window
        size = right - left, bottom - top
        height, width = out.shape[:2]
        reduce = whole_reduction(size, (width, height))
        exact = (size[0] // reduce, size[1] // reduce) == (width, height)
        shape = (size[1] // reduce, size[0] // reduce, 3)
        made = out if exact else np.empty(shape, np.uint8)
        self.source.window(self.index, left, top, *size, reduce, made)
        if not exact:
            average(made, out)


Picture = NDArray[np.uint8] | WindowedPicture


def picture_of(source: FrameSource, index: int) -> Picture:
    """Return frame `index`, not yet made where the source can be read by windows."""
    if reads_windows(source):
        return WindowedPicture(source=source, index=index)
    return checked_picture(source, index)


def reads_windows(source: FrameSource) -> TypeGuard[WindowSource]:
    """Whether a source has the optional method `window`."""
    return callable(getattr(source, "window", None))


def whole_reduction(size_px: tuple[int, int], to_px: tuple[int, int]) -> int:
    """Return by how much a source is asked to reduce a window that is read as `to_px`.

    It is the largest whole number that divides both sides and leaves a whole number for the second
    step, or at least `LEAST_REST`: averaging twice by a little blurs.

    >>> whole_reduction((16320, 9184), (2040, 1148)), whole_reduction((1920, 1080), (640, 360))
    (8, 3)
    >>> whole_reduction((7680, 4320), (1358, 764)), whole_reduction((1920, 1080), (1358, 764))
    (2, 1)
    """
    most = max(1, min(side // to for side, to in zip(size_px, to_px, strict=True)))
    for reduce in range(most, 1, -1):
        if any(side % reduce for side in size_px):
            continue
        rests = [side / reduce / to for side, to in zip(size_px, to_px, strict=True)]
        if all(rest.is_integer() or rest >= LEAST_REST for rest in rests):
            return reduce
    return 1
