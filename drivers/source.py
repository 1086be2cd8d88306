"""The contract between the simulated sensor and sources of full-resolution pictures.

A source delivers the full-resolution video v of Eq. 1, frame by frame, and the truth if known.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

CLASS_OF_ROLE = {  # detector class by role in the ground truth
    "player": "player",
    "goalkeeper": "player",
    "main referee": "referee",
    "assistant referee": "referee",
    "ball": "ball",
}
LEAST_VISIBLE = 0.25  # share; less visible objects count neither as found nor as missed


@dataclass(frozen=True, kw_only=True, eq=False)
class Annotations:
    """Ground truth of one picture; n may be 0. Graphs send it as `pipeline.messages.Truth`."""

    boxes: NDArray[np.float32]  # (n, 4) xyxy, full-resolution pixels
    ids: NDArray[np.int32]  # (n,), constant per object over the whole source
    labels: tuple[str, ...]  # n of: ball, player, goalkeeper, main referee, assistant referee, …
    visibility: NDArray[np.float32]  # (n,) share of the object that is not hidden, 0..1


class FrameSource(Protocol):
    """A full-resolution video. Construction opens it and raises `DriverError` when it cannot.

    A class whose pictures are all of one kind says so in a class attribute, `shows = "soccer"`.
    """

    size_px: tuple[int, int]  # width, height
    rate_hz: float  # 0: it has none of its own, as a folder of pictures
    length: int | None  # frames; None: endless

    def picture(self, index: int) -> NDArray[np.uint8]:
        """Frame `index` as (h, w, 3) RGB, valid until the next call; IndexError past the end.

        Asking in ascending order is fast; any order is allowed. Raises `DriverError` naming file
        and place when the picture cannot be read.
        """
        ...

    def truth(self, index: int) -> Annotations | None:
        """What is in frame `index`; None where the source does not know."""
        ...

    def close(self) -> None:
        """Release files and threads."""
        ...


class WindowSource(FrameSource, Protocol):
    """A source whose pictures are too large to be made whole: sensors read windows of them."""

    def window(
        self,
        index: int,
        left: int,
        top: int,
        width: int,
        height: int,
        reduce: int,
        out: NDArray[np.uint8],
    ) -> None:
        """Fill `out` (height / reduce, width / reduce, 3) with a window of frame `index`, RGB.

        Each pixel is the mean of `reduce` x `reduce` pixels of `picture`, up to rounding. The
        window is inside the picture and its sides are multiples of `reduce`; its corner need not
        be. One thread calls at a time, in any order of frames; several windows of a frame follow
        one another. Raises as `picture` does.
        """
        ...
