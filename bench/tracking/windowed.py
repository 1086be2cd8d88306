"""A clip that is too large to be kept: a source read by windows -> exposures, drawn when needed.

20 clips of 250 frames of 7680x4320 would take 500 GB as pictures. Nothing is kept of them but their
truth and the contexts used last. Full resolution is a window around what the tracker follows, which
is all that it looks at; it is counted as the whole picture that a sensor would have read.
"""

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.tracking.budgets import Acquisition
from bench.tracking.clip import RATE_HZ, Clip, ClipName
from bench.tracking.stages import Camera
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
        self._near: Window = (0, 0, 0, 0)
        self._kept: OrderedDict[int, Frame] = OrderedDict()
        self._most = max(1, CONTEXT_BYTES // (3 * math.prod(how.sampling.context_px)))

    def near(self, box: NDArray[np.float32]) -> None:
        """Let full resolution be a square around a box (4,), in sensor pixels."""
        sides = np.maximum(box[2:] - box[:2], 1)
        side = NEAR_SIZES * max(float(np.sqrt(sides.prod())), float(sides.max()) / 2)
        side = float(np.clip(-(-side // STEP_PX) * STEP_PX, *NEAR_PX))
        corners = []
        for axis, most in enumerate(self._size_px):
            wide = min(int(side), most)
            at = float(box[axis] + box[axis + 2]) / 2 - wide / 2
            corners.append((int(np.clip(at, 0, most - wide)), wide))
        (left, wide), (top, high) = corners
        self._near = (left, top, left + wide, top + high)

    def expose(self, frame: int, first: int, window: Window) -> tuple[Frame, Frame]:
        """Return context and ROI of one exposure, and count the pixels of the sensor."""
        context, roi = self.context(frame, first), self.roi(frame, window)
        self.exposures += 1
        self.emitted_px += self.how.sampling.emitted_px()
        return context, roi

    def context(self, frame: int, first: int = 0) -> Frame:
        """Return the whole field at `frame`, or at full resolution what is near the object.

        With averaging it is the mean of `first` … `frame`. Raises `RunError` without `near`.
        """
        if self._full:
            return self._around(frame, first if self.how.sampling.averaged else frame)
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

    def _around(self, frame: int, first: int) -> Frame:
        left, top, right, bottom = self._near
        if right <= left:
            raise RunError(f"frame {frame}: full resolution needs `near` before an exposure")
        parts: Sequence[NDArray[np.uint8]] = [
            np.empty((bottom - top, right - left, 3), np.uint8) for _ in range(first, frame + 1)
        ]
        for index, out in zip(range(first, frame + 1), parts, strict=True):
            self._picture(index).read(self._near, out)
        pixels = parts[0]
        if len(parts) > 1:
            mean = np.mean(parts, axis=0, dtype=np.float32)
            pixels = np.asarray(np.rint(mean), np.uint8)
        return Frame(header=self.header(frame), pixels=pixels, window=self._near)

    def _picture(self, frame: int) -> WindowedPicture:
        return WindowedPicture(source=self._source, index=self._first + frame)
