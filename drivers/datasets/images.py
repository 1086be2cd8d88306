"""A folder of pictures as a video: its files in order of name in, RGB pictures out."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.datasets.pictures import read_picture
from drivers.source import Annotations
from pipeline.errors import DriverError

SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp"})


class ImageFolder:
    """A `FrameSource` without rate and truth; all pictures have the size of the first."""

    def __init__(self, *, path: str) -> None:
        folder = Path(path)
        if not folder.is_dir():
            raise DriverError(f"{folder}: expected a folder of pictures, got no such folder")
        self._files = sorted(f for f in folder.iterdir() if f.suffix.lower() in SUFFIXES)
        if not self._files:
            raise DriverError(f"{folder}: expected pictures ({', '.join(sorted(SUFFIXES))}), got 0")
        self._buffer = read_picture(self._files[0])
        height, width = self._buffer.shape[:2]
        self.size_px = (width, height)
        self.rate_hz = 0.0
        self.length: int | None = len(self._files)

    def picture(self, index: int) -> NDArray[np.uint8]:
        """Read frame `index` (h, w, 3) RGB, valid until the next call; IndexError past the end."""
        if not 0 <= index < len(self._files):
            raise IndexError(f"no picture {index} in {len(self._files)}")
        return read_picture(self._files[index], self._buffer)

    def truth(self, index: int) -> Annotations | None:
        """Return None: the truth is not known."""
        return None

    def close(self) -> None:
        """Do nothing: no file is open between pictures."""
