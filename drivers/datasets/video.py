"""A video file: its path in, RGB pictures out."""

import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.regular_file import library_name, opened
from drivers.source import Annotations
from pipeline.errors import DriverError

SKIP_FRAMES = 48  # up to so many frames ahead, skipping is cheaper than seeking to a key frame


class VideoFile:
    """A `FrameSource` without truth, over the formats that OpenCV's FFmpeg decodes.

    `length` is the number of readable frames: containers often declare a few too many.
    """

    def __init__(self, *, path: str) -> None:
        self._path = Path(path)
        if not self._path.is_file():
            got = "a folder" if self._path.is_dir() else "no such file"
            raise DriverError(f"{path}: expected a video file, got {got}")
        with opened(self._path, sys.maxsize) as file:
            name = library_name(self._path, file)
            self._capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG)
        if not self._capture.isOpened():
            raise DriverError(f"{path}: expected a video, got something that cannot be decoded")
        self.rate_hz = float(self._capture.get(cv2.CAP_PROP_FPS))
        promised = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        if not (self.rate_hz > 0 and promised > 0):
            self.close()
            raise DriverError(
                f"{path}: expected a rate and a length, got {self.rate_hz:g} Hz, {promised} frames"
            )
        width, height = (
            int(self._capture.get(key))
            for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        )
        self.size_px = (width, height)
        self._raw = np.empty((height, width, 3), np.uint8)
        self._rgb = np.empty_like(self._raw)
        self._next = 0
        self.length: int | None = self._readable(promised)

    def picture(self, index: int) -> NDArray[np.uint8]:
        """Read frame `index` (h, w, 3) RGB, valid until the next call; IndexError past the end."""
        if not 0 <= index < (self.length or 0):
            raise IndexError(f"{self._path}: no frame {index} in {self.length}")
        if index == self._next - 1:
            return self._rgb
        if not self._read(index):
            raise DriverError(f"{self._path}: frame {index} of {self.length} cannot be decoded")
        cv2.cvtColor(self._raw, cv2.COLOR_BGR2RGB, self._rgb)
        return self._rgb

    def truth(self, index: int) -> Annotations | None:
        """Return None: the truth is not known."""
        return None

    def close(self) -> None:
        """Release the decoder."""
        self._capture.release()

    def _readable(self, promised: int) -> int:
        """Return the declared number of frames minus missing ones at the end."""
        for length in range(promised, max(0, promised - max(2, round(self.rate_hz))), -1):
            if self._read(length - 1):
                self._next = -1  # the picture of this frame was not converted
                return length
        self.close()
        raise DriverError(
            f"{self._path}: expected {promised} frames, got a file that ends before the last second"
        )

    def _read(self, index: int) -> bool:
        ahead = index - self._next
        if not 0 <= ahead <= SKIP_FRAMES or self._next < 0:
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, index)
            ahead = 0
        self._next = -1  # after a failure the decoder's position is not known
        for _ in range(ahead):
            if not self._capture.grab():
                return False
        done, frame = self._capture.read(self._raw)
        if not done or frame.shape != self._raw.shape:
            return False
        self._raw = np.asarray(frame, np.uint8)
        self._next = index + 1
        return True
