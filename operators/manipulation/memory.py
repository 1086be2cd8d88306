"""What the ROI showed before: pictures of context and ROI in, one picture that keeps sharp parts.

A part that the ROI once showed stays as sharp as it was seen for as long as the context over it
stays the same. An object that lies still needs one look; what moves is seen as the context has it.
"""

from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline import Shape

AROUND_PX = 5  # side of the square over which a change is averaged: noise of one pixel is none

Picture = NDArray[np.uint8]  # (h, w, 3)


@dataclass(frozen=True, kw_only=True)
class MemoryState:
    """What was seen, for a successor; without pixels: nothing."""

    sharp: Annotated[NDArray[np.uint8], Shape.of("h", "w", 3)]
    context: Annotated[NDArray[np.uint8], Shape.of("h", "w", 3)]
    known: Annotated[NDArray[np.bool_], Shape.of("h", "w")]


class SharpMemory:
    """Keeps what the ROI showed, pixel by pixel, until the context there changes."""

    def __init__(self, change_levels: float) -> None:
        """`change_levels`: of 255, in the channel that differs most, that tell a change."""
        self._change_levels = change_levels
        self.forget()

    def forget(self) -> None:
        """Keep nothing."""
        self._sharp = self._context = np.zeros((0, 0, 3), np.uint8)
        self._known = np.zeros((0, 0), bool)

    def add(self, context: Picture, sharp: Picture, seen: NDArray[np.bool_]) -> Picture:
        """Return the picture of this frame.

        `context`: the enlarged context; `sharp`: the same with the ROI in its place; `seen` (h, w):
        where the ROI lies.
        """
        picture = np.where(seen[..., None], sharp, context)
        if self._known.shape == seen.shape:
            apart = cv2.absdiff(context, self._context).max(2).astype(np.float32)
            same = cv2.blur(apart, (AROUND_PX, AROUND_PX)) < self._change_levels
            kept = self._known & same & ~seen
        else:
            kept, self._context = np.zeros_like(seen), context.copy()
            self._sharp = sharp.copy()
        picture[kept] = self._sharp[kept]
        self._sharp = picture.copy()
        self._context[~kept] = context[~kept]
        self._known = kept | seen
        return picture

    def state(self) -> MemoryState:
        """Return what is kept."""
        return MemoryState(sharp=self._sharp, context=self._context, known=self._known)

    def restore(self, state: MemoryState) -> None:
        """Take over what another kept, unless its parts do not belong together."""
        if state.sharp.shape == state.context.shape == (*state.known.shape, 3):
            self._sharp, self._context = state.sharp.copy(), state.context.copy()
            self._known = state.known.copy()
