"""The simulated sensor over a clip, without its process: a frame and a window -> what is read.

A clip that is read by windows has no whole pictures. Where a strategy reads every pixel of it, a
tracker is shown a small picture of the whole and, at full resolution, the object and its search
area; the sensor's count is that of all pixels. Reduced pictures of the whole field are made once
for all cameras that share a `Kept`.
"""

import math
import os
from collections import OrderedDict
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.tracking.budgets import TOLERANCE, Acquisition
from bench.tracking.clip import Clip
from drivers.commands import Window
from drivers.readout import scaled
from drivers.simulated.readout import Readout
from drivers.simulated.windows import WindowedPicture
from pipeline.boxes import centres, sizes
from pipeline.errors import RunError
from pipeline.messages import Frame, Header

EMPTY: Window = (0, 0, 0, 0)
OVERVIEW = 0.25  # side of the small picture of the whole, at most `OVERVIEW_PX` wide
OVERVIEW_PX = 2040
SEARCH_SIZES = 8.0  # side of the search area in sizes of the box; both trackers look at 6 or less
LEAST_SEARCH_PX = 128
KEPT_BYTES = 3 << 30  # of reduced pictures; 250 of 1920x1080 are 1.6 GB
KEPT_SHARE = 8  # of the machine's memory, at most: one over this


class Kept:
    """Reduced pictures of a clip's whole field, by size and frame, up to a number of bytes.

    Where there is no room, pictures of the size that was longest unused go; of the size in use none
    goes, because frames are read in order, again and again.
    """

    def __init__(self, most_bytes: int = 0) -> None:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        self._most = most_bytes or min(KEPT_BYTES, memory // KEPT_SHARE)
        self._pictures: OrderedDict[tuple[int, int], dict[int, NDArray[np.uint8]]] = OrderedDict()
        self.nbytes = 0

    def get(self, size_px: tuple[int, int], frame: int) -> NDArray[np.uint8] | None:
        """Return the picture of a frame; None: it is not kept."""
        self._pictures.setdefault(size_px, {})
        self._pictures.move_to_end(size_px)
        return self._pictures[size_px].get(frame)

    def put(self, size_px: tuple[int, int], frame: int, pixels: NDArray[np.uint8]) -> None:
        """Keep the picture of a frame if there is room; nobody may write into it."""
        pixels.flags.writeable = False
        while self.nbytes + pixels.nbytes > self._most:
            oldest = next(iter(self._pictures))
            if oldest == size_px:
                return
            self.nbytes -= sum(each.nbytes for each in self._pictures.pop(oldest).values())
        self._pictures[size_px][frame] = pixels
        self.nbytes += pixels.nbytes


class Camera:
    """The simulated sensor's reading of a clip, exposure by exposure, with given ROI windows."""

    def __init__(self, clip: Clip, how: Acquisition, kept: Kept | None = None) -> None:
        self._clip, self.how = clip, how
        self._kept = kept or Kept()
        width, height = clip.size_px
        most_px = math.prod(how.sampling.roi_px) if clip.windowed else width * height
        self._readout = Readout(seed=0, most_px=most_px)
        self._whole = (0, 0, width, height)
        self._roi = np.empty(self._readout.shape(how.sampling.roi_px), np.uint8)
        self.begin()

    @property
    def by_windows(self) -> bool:
        """Whether every pixel is counted, but only the surroundings of the object are made."""
        return self._clip.windowed and self.how.sampling.context_px == self._clip.size_px

    def begin(self) -> None:
        """Reset the counts."""
        self.emitted_px = self.exposures = 0

    def expose(
        self, frame: int, first: int, window: Window, near: NDArray[np.float32] | None = None
    ) -> tuple[Frame, Frame]:
        """Return context and ROI of one exposure, and count their pixels.

        `near` (4,) is where the object is searched for, where pictures are read by windows.
        """
        context = self.context(frame, first)
        roi = self.roi(frame, window)
        self.exposures += 1
        self.emitted_px += math.prod(roi.size_px) + math.prod(self.how.sampling.context_px)
        if self.by_windows and near is not None:
            roi = self.around(frame, near, first)
        return context, roi

    def counted(self) -> tuple[int, int]:
        """Return the pixels read since `begin`, and those of full resolution in the same time.

        An exposure counts for all frames until the next one, also if the clip ends before it.
        Raises `RunError` if the ratio is not the budget.
        """
        frames = self.exposures * self.how.sampling.interval
        full_px = frames * math.prod(self._clip.size_px)
        if self.exposures and not self.how.met_by(self.emitted_px / full_px):
            raise RunError(
                f"{self._clip.name}: {self.how.strategy} read {self.emitted_px / full_px:.5f} of "
                f"the pixels, expected {float(self.how.budget):.5f} within {TOLERANCE:.0%}"
            )
        return self.emitted_px, full_px

    def header(self, frame: int) -> Header:
        """Return the header of a frame of the clip."""
        stream = f"{self._clip.name}"
        return Header(stream=stream, seq=frame, stamp_ns=0, geometry=self.how.geometry)

    def context(self, frame: int, first: int = 0) -> Frame:
        """Return the whole field at `frame`; with averaging the mean of `first` … `frame`.

        Pictures of the full size are views of the clip's; of a clip that is read by windows they
        are made small.
        """
        header = self.header(frame)
        if self.by_windows:
            share = min(OVERVIEW, OVERVIEW_PX / self._clip.size_px[0])
            size_px = scaled(self._clip.size_px, share, 1)
            pixels = self._mean(frame, first, lambda k: self._reduced(size_px, k))
            return Frame(header=header, pixels=pixels, window=self._whole)
        if self.how.sampling.averaged:
            pictures = self._clip.pictures[first : frame + 1]
            whole = [each for each in pictures if not isinstance(each, WindowedPicture)]
            mean = np.mean(whole, axis=0, dtype=np.float32)
            return Frame(header=header, pixels=np.rint(mean).astype(np.uint8), window=self._whole)
        picture = self._clip.pictures[frame]
        if self.how.sampling.context_px == self._clip.size_px:
            if isinstance(picture, WindowedPicture):  # `by_windows` reads those
                raise RunError(f"{self._clip.name}: expected whole pictures, got windows")
            return Frame(header=header, pixels=picture, window=self._whole)
        pixels = self._reduced(self.how.sampling.context_px, frame)
        return Frame(header=header, pixels=pixels, window=self._whole)

    def nothing(self, frame: int) -> Frame:
        """Return a picture without pixels."""
        pixels = np.empty((0, 0, 3), np.uint8)
        return Frame(header=self.header(frame), pixels=pixels, window=EMPTY)

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
        self._readout.read(self._clip.pictures[frame], window, self._roi, seq=frame, port=1)
        return Frame(header=self.header(frame), pixels=self._roi, window=window)

    def around(self, frame: int, box: NDArray[np.float32], first: int | None = None) -> Frame:
        """Return the search area around a box (4,) at full resolution; it is not counted.

        `first`: of the frames that the exposure at `frame` averages; None: as many as it has.
        """
        window = search_area(box, self._clip.size_px)
        size_px = window[2] - window[0], window[3] - window[1]
        begun = frame - self.how.sampling.interval + 1 if first is None else first
        pixels = self._mean(frame, begun, lambda k: self._read(window, size_px, k))
        return Frame(header=self.header(frame), pixels=pixels, window=window)

    def _reduced(self, size_px: tuple[int, int], frame: int) -> NDArray[np.uint8]:
        """Return the whole field at a size, a kept one again."""
        known = self._kept.get(size_px, frame)
        if known is None:
            known = self._read(self._whole, size_px, frame)
            self._kept.put(size_px, frame, known)
        return known

    def _read(self, window: Window, size_px: tuple[int, int], frame: int) -> NDArray[np.uint8]:
        out = np.empty(self._readout.shape(size_px), np.uint8)
        self._readout.read(self._clip.pictures[frame], window, out, seq=frame, port=0)
        return out

    def _mean(
        self, frame: int, first: int, read: Callable[[int], NDArray[np.uint8]]
    ) -> NDArray[np.uint8]:
        """Return what is read at `frame`; with averaging the mean over `first` … `frame`."""
        last = read(frame)
        if not self.how.sampling.averaged or first == frame:
            return last
        total = last.astype(np.float32)
        for each in range(first, frame):
            cv2.accumulate(read(each), total)
        return np.rint(total / (frame + 1 - first)).astype(np.uint8)


def search_area(box: NDArray[np.float32], size_px: tuple[int, int]) -> Window:
    """Return a square around a box, moved and cut to be inside the field.

    >>> search_area(np.array([100, 100, 140, 140], np.float32), (4000, 1000))
    (0, 0, 320, 320)
    """
    side = int(max(SEARCH_SIZES * float(sizes(box[None])[0]), LEAST_SEARCH_PX))
    wide, high = (min(side, most) for most in size_px)
    x, y = (float(v) for v in np.nan_to_num(centres(box)))
    left = int(np.clip(x - wide / 2, 0, size_px[0] - wide))
    top = int(np.clip(y - high / 2, 0, size_px[1] - high))
    return left, top, left + wide, top + high
