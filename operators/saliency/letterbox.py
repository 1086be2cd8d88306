"""Fit a picture of any size into a network's input: (h, w[, 3]) uint8 -> (1, 3, H, W) float32.

A network that reads what changed since the frame before has it in a fourth plane.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

LEAST_GAIN = 1.07


@dataclass(frozen=True, kw_only=True)
class Placement:
    """Where the picture lies in the input: input = picture * gain + offset."""

    gain: float
    left_px: int
    top_px: int
    width_px: int
    height_px: int


class Letterbox:
    """A reused input tensor; pictures are scaled with their aspect kept, the rest is `fill`."""

    def __init__(
        self,
        width_px: int,
        height_px: int,
        *,
        scale: float,
        bgr: bool,
        corner: bool,
        fill: int = 114,
        keep: bool = False,
        difference: bool = False,
    ) -> None:
        self._scale = np.float32(scale)
        self._order = (2, 1, 0) if bgr else (0, 1, 2)
        self._corner, self._keep = corner, keep
        self._fill = np.float32(fill * scale)
        self.tensor = np.full(
            (1, 4 if difference else 3, height_px, width_px), self._fill, np.float32
        )
        self._source: tuple[int, ...] = ()
        self._placement = Placement(gain=1, left_px=0, top_px=0, width_px=0, height_px=0)
        self._planes: list[NDArray[np.uint8]] = []

    def put(
        self, picture: NDArray[np.uint8], difference: NDArray[np.int16] | None = None
    ) -> Placement:
        """Write one RGB or grey picture, and (h, w) the levels by which it changed."""
        if picture.shape != self._source:
            self._arrange(picture)
        p = self._placement
        if picture.shape[:2] != (p.height_px, p.width_px):
            # linear looks at two pixels a side: below one half it would lose small objects
            how = cv2.INTER_AREA if p.gain < 0.5 else cv2.INTER_LINEAR
            picture = cv2.resize(picture, (p.width_px, p.height_px), interpolation=how)  # type: ignore[assignment]
        # planes first: a strided conversion of the interleaved picture takes three times as long
        cv2.split(picture, self._planes)
        rows = slice(p.top_px, p.top_px + p.height_px)
        columns = slice(p.left_px, p.left_px + p.width_px)
        planes = self.tensor[0, :, rows, columns]
        if len(planes) > 3:
            _put_difference(difference, planes[3])
        for channel, target in zip(self._order, planes[:3], strict=True):
            plane = self._planes[channel if len(self._planes) == 3 else 0]
            np.multiply(plane, self._scale, out=target)
        return p

    def _arrange(self, picture: NDArray[np.uint8]) -> None:
        self._source = picture.shape
        height_px, width_px = self.tensor.shape[2:]
        self._placement = place(
            picture.shape[1], picture.shape[0], width_px, height_px, self._corner, self._keep
        )
        shape = (self._placement.height_px, self._placement.width_px)
        self._planes = [np.empty(shape, np.uint8) for _ in range(3 if picture.ndim == 3 else 1)]
        self.tensor[:, :3] = self._fill
        self.tensor[:, 3:] = 0


def _put_difference(difference: NDArray[np.int16] | None, target: NDArray[np.float32]) -> None:
    """Write levels of brightness as shares of the greatest one, -1..1; 0 where none are known."""
    if difference is None:
        target[:] = 0
        return
    if difference.shape != target.shape:
        how = cv2.INTER_AREA if target.shape[0] < difference.shape[0] / 2 else cv2.INTER_LINEAR
        difference = cv2.resize(difference, target.shape[::-1], interpolation=how)  # type: ignore[assignment]
    np.multiply(difference, np.float32(1 / 255), out=target)


def place(
    width_px: int, height_px: int, into_width_px: int, into_height_px: int, corner: bool,
    keep: bool = False,
) -> Placement:  # fmt: skip
    """Scale (w, h) to the largest size inside (W, H); in the top left corner or in the middle.

    With `keep` a picture that nearly fills (W, H) keeps its pixels: to enlarge it by less than
    `LEAST_GAIN` would take time and blur it.

    >>> place(480, 270, 480, 288, False)
    Placement(gain=1.0, left_px=0, top_px=9, width_px=480, height_px=270)
    >>> place(2040, 1148, 2048, 1152, False, keep=True)
    Placement(gain=1.0, left_px=4, top_px=2, width_px=2040, height_px=1148)
    """
    gain = min(into_width_px / width_px, into_height_px / height_px)
    if keep and 1 < gain < LEAST_GAIN:
        gain = 1.0
    wide, high = max(1, round(width_px * gain)), max(1, round(height_px * gain))
    left, top = (0, 0) if corner else ((into_width_px - wide) // 2, (into_height_px - high) // 2)
    return Placement(gain=gain, left_px=left, top_px=top, width_px=wide, height_px=high)
