"""Read picture files and detect truncated ones: a path in, RGB pixels out."""

import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DriverError

# end markers of complete files; in JPEG data these two bytes cannot follow each other
ENDINGS = {".jpg": b"\xff\xd9", ".jpeg": b"\xff\xd9", ".png": b"IEND"}
TAIL_BYTES = 4096  # some cameras pad the end of a file


def read_picture(path: Path, out: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
    """Return the picture as (h, w, 3) RGB, decoded into `out` if given.

    Raises `DriverError` naming the file when it is missing, truncated, no picture, or not of the
    size of `out`. Decoders fill missing parts with grey, so the end of the file is checked.
    """
    ending = ENDINGS.get(path.suffix.lower())
    tail = _tail(path)
    if ending and ending not in tail:
        raise DriverError(f"{path}: expected a whole picture, got a truncated file")
    found = _decode(path, out)
    if found is None:
        raise DriverError(f"{path}: expected a picture, got something that cannot be decoded")
    if out is not None and found.shape != out.shape:
        expected, got = (f"{s[1]}x{s[0]}" for s in (out.shape, found.shape))
        raise DriverError(f"{path}: expected {expected} like the pictures before, got {got}")
    return np.asarray(found, np.uint8)


def _tail(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - TAIL_BYTES))
            return file.read()
    except OSError as error:
        raise DriverError(f"{path}: cannot be read: {error.strerror}") from error


def _decode(path: Path, out: NDArray[np.uint8] | None) -> NDArray[Any] | None:
    if out is not None:
        try:
            return cv2.imread(os.fspath(path), out, cv2.IMREAD_COLOR_RGB)
        except cv2.error:
            pass  # wrong size: decode it elsewhere, to report the size
    return cv2.imread(os.fspath(path), cv2.IMREAD_COLOR_RGB)
