"""A clip that is too large to be kept: a source read by windows -> exposures, drawn when needed.

20 clips of 250 frames of 7680x4320 would take 500 GB as pictures. Nothing is kept of them but their
truth and the contexts used last. Full resolution is a window around what the tracker follows, which
is all that it looks at; it is counted as the whole picture that a sensor would have read.
"""

import math
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.tracking.budgets import Acquisition
from bench.tracking.clip import RATE_HZ, Clip, ClipName
from bench.tracking.stages import EMPTY, Camera
from drivers.commands import Window
from drivers.scenes import WholePitchScene
from drivers.simulated.windows import WindowedPicture
from drivers.source import WindowSource
from pipeline.errors import DriverError, RunError
from pipeline.messages import Frame

NEAR_PX = 512, 4096  # least and largest side of a window of full resolution
NEAR_SIZES = 12.0  # its side in sizes of the object; trackers look at about 5
STEP_PX = 64  # its sides are multiples of it
CONTEXT_BYTES = 256 << 20  # of contexts that are kept

Box = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class WindowedClip:
    """F frames of a source that can be read by windows."""

    clip: Clip  # name, size and truth; it has no pictures
    source: WindowSource
    first: int  # number in the source of the clip's first frame


def windowed(source: WindowSource, name: ClipName, frames: range) -> WindowedClip:
    """Return some consecutive frames of a source; raises `DriverError` without truth."""
    truths = []
    for index in frames:
        truth = source.truth(index)
        if truth is None:
            raise DriverError(f"{name}: frame {index + 1} has no truth to score by")
        truths.append(truth)
    clip = Clip(name=name, size_px=source.size_px, pictures=(), truths=truths)
    return WindowedClip(clip=clip, source=source, first=frames.start)


def whole_pitch(
    seed: int, frames: range, *, size_px: tuple[int, int] = (7680, 4320), **options: Any
) -> WindowedClip:
    """Return a clip of the whole pitch; `options` are `view`, `light` and `weather`."""
    scene = WholePitchScene(size_px=size_px, rate_hz=RATE_HZ, seed=seed, **options)
    return windowed(scene, ClipName(seed=seed), frames)


class WindowedCamera(Camera):
    """`Camera` over a `WindowedClip`: the same frames, but for the extent of full resolution.

    With strategies whose context is the whole field at full resolution, `near` must be told what
    the tracker follows before each exposure; what is far from it is black to the tracker.
    """

    def __init__(self, clip: WindowedClip, how: Acquisition) -> None:
        super().__init__(clip.clip, how)
        self._source, self._first, self._size_px = clip.source, clip.first, clip.clip.size_px
        self._full = how.sampling.context_px == self._size_px
        self._near: Window = EMPTY
        self._cue: Window = EMPTY
        self._kept: OrderedDict[int, Frame] = OrderedDict()
        self._most = max(1, CONTEXT_BYTES // (3 * math.prod(how.sampling.context_px)))

    def near(self, box: Box, cue: Box | None = None) -> None:
        """Let full resolution be a square around a box (4,), in sensor pixels.

        `cue`, if any, is a second place at which a tracker looks, when the policy disagrees with
        it: a second square, which takes the place of the ROI.
        """
        self._near = self._square(box)
        self._cue = EMPTY if cue is None else self._square(cue)

    def expose(self, frame: int, first: int, window: Window) -> tuple[Frame, Frame]:
        """Return context and ROI of one exposure, and count the pixels of the sensor."""
        context = self.context(frame, first)
        if self._full and self._cue != EMPTY:
            roi = self._around(frame, self._earliest(frame, first), self._cue)
        else:
            roi = self.roi(frame, window)
        self.exposures += 1
        self.emitted_px += self.how.sampling.emitted_px()
        return context, roi

    def context(self, frame: int, first: int = 0) -> Frame:
        """Return the whole field at `frame`, or at full resolution what is near the object.

        With averaging it is the mean of `first` … `frame`. Raises `RunError` without `near`.
        """
        if self._full:
            if self._near == EMPTY:
                raise RunError(f"frame {frame}: full resolution needs `near` before an exposure")
            return self._around(frame, self._earliest(frame, first), self._near)
        if frame not in self._kept:
            out = np.empty(self._readout.shape(self.how.sampling.context_px), np.uint8)
            self._readout.read(self._picture(frame), self._whole, out, seq=frame, port=0)
            self._kept[frame] = Frame(header=self.header(frame), pixels=out, window=self._whole)
            if len(self._kept) > self._most:
                self._kept.popitem(last=False)
        self._kept.move_to_end(frame)
        return self._kept[frame]

    def roi(self, frame: int, window: Window) -> Frame:
        """Return the ROI at `frame`, valid until the next one; empty for strategies without.

        Raises `RunError` for a window of another size: it would cost more pixels than are counted.
        """
        if not self.how.looks:
            return self.nothing(frame)
        left, top, right, bottom = window
        if (right - left, bottom - top) != self.how.sampling.roi_px:
            raise RunError(
                f"frame {frame}: expected a window of {self.how.sampling.roi_px}, got {window}"
            )
        self._readout.read(self._picture(frame), window, self._roi, seq=frame, port=1)
        return Frame(header=self.header(frame), pixels=self._roi, window=window)

    def _square(self, box: Box) -> Window:
        """Return a square around a box, inside the field."""
        sides = np.maximum(box[2:] - box[:2], 1)
        size = max(float(np.sqrt(sides.prod())), float(sides.max()) / 2)
        side = float(np.clip(-(-NEAR_SIZES * size // STEP_PX) * STEP_PX, *NEAR_PX))
        (left, wide), (top, high) = (
            _placed(float(box[axis] + box[axis + 2]) / 2, int(side), most)
            for axis, most in enumerate(self._size_px)
        )
        return left, top, left + wide, top + high

    def _earliest(self, frame: int, first: int) -> int:
        return first if self.how.sampling.averaged else frame

    def _around(self, frame: int, first: int, window: Window) -> Frame:
        left, top, right, bottom = window
        parts = np.empty((frame + 1 - first, bottom - top, right - left, 3), np.uint8)
        for index, out in enumerate(parts, first):
            self._picture(index).read(window, out)
        pixels = parts[0]
        if len(parts) > 1:
            pixels = np.asarray(np.rint(parts.mean(0, dtype=np.float32)), np.uint8)
        return Frame(header=self.header(frame), pixels=pixels, window=window)

    def _picture(self, frame: int) -> WindowedPicture:
        return WindowedPicture(source=self._source, index=self._first + frame)


def _placed(middle: float, side: int, most: int) -> tuple[int, int]:
    """Return where a side begins so that it is inside 0 to `most`, and its length there."""
    side = min(side, most)
    return int(np.clip(middle - side / 2, 0, most - side)), side
