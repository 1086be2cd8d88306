"""Read picture files and detect truncated ones: a path in, RGB pixels out."""

import os
import re
from pathlib import Path
from typing import BinaryIO

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.regular_file import MOST_NAME, library_name, opened
from pipeline.errors import DriverError
from pipeline.text import harmless

# end markers of complete files; in JPEG data these two bytes cannot follow each other
ENDINGS = {".jpg": b"\xff\xd9", ".jpeg": b"\xff\xd9", ".png": b"IEND"}
TAIL_BYTES = 4096  # some cameras pad the end of a file
MOST_BYTES = 1 << 30  # of a file
MOST_SIDE_PX, MOST_PIXELS = 32_768, 1 << 28  # of a picture; a few bytes of PNG may tell any size
_SIZE = re.compile(r"'size' is \[(\d+) x (\d+)\]")  # width, height


def read_picture(path: Path, out: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
    """Return the picture as (h, w, 3) RGB, decoded into `out` if given.

    Raises `DriverError` naming the file when it is missing, truncated, no picture, too large, or
    not of the size of `out`. Decoders fill missing parts with grey, so the end of the file is
    checked.
    """
    where = harmless(str(path), MOST_NAME)
    with opened(path, MOST_BYTES) as file:
        ending = ENDINGS.get(path.suffix.lower())
        if ending and ending not in _tail(where, file):
            raise DriverError(f"{where}: expected a whole picture, got a truncated file")
        return _decoded(where, library_name(path, file), out)


def check_size(where: str | Path, size_px: tuple[int, int]) -> None:
    """Raise `DriverError` for a picture larger than any that is decoded."""
    if max(size_px) > MOST_SIDE_PX or size_px[0] * size_px[1] > MOST_PIXELS:
        raise DriverError(
            f"{where}: expected a picture with sides of at most {MOST_SIDE_PX} and at most "
            f"{MOST_PIXELS} pixels, got {_by(size_px)}"
        )


def _tail(where: str, file: BinaryIO) -> bytes:
    try:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - TAIL_BYTES))
        return file.read(TAIL_BYTES)
    except OSError as error:
        raise DriverError(f"{where}: cannot be read: {error.strerror}") from error


def _decoded(where: str, name: str, out: NDArray[np.uint8] | None) -> NDArray[np.uint8]:
    size_px, wanted_px = _stated_size(name), None if out is None else _size(out)
    if size_px is not None:
        check_size(where, size_px)
        if wanted_px is not None and sorted(size_px) != sorted(wanted_px):  # it may be turned
            raise _other_size(where, wanted_px, size_px)
    try:
        if out is not None and size_px == wanted_px:
            found = cv2.imread(name, out, cv2.IMREAD_COLOR_RGB)
        else:
            found = cv2.imread(name, cv2.IMREAD_COLOR_RGB)
    except cv2.error:
        found = None
    if found is None:
        raise DriverError(f"{where}: expected a picture, got something that cannot be decoded")
    pixels = np.asarray(found, np.uint8)
    check_size(where, _size(pixels))
    if wanted_px is not None and _size(pixels) != wanted_px:
        raise _other_size(where, wanted_px, _size(pixels))
    return pixels


def _stated_size(name: str) -> tuple[int, int] | None:
    """Return the size that the file states, before it is decoded; None: not known.

    OpenCV compares it with the memory that it is given, and names it in its refusal. Where a file
    states none, it leaves that memory as it was and returns it.
    """
    try:
        cv2.imread(name, np.empty((1, 2, 3), np.uint8), cv2.IMREAD_COLOR_RGB)
    except cv2.error as error:
        if told := _SIZE.search(str(error)):
            return int(told[1]), int(told[2])
    return None


def _other_size(where: str, expected: tuple[int, int], got: tuple[int, int]) -> DriverError:
    return DriverError(
        f"{where}: expected {_by(expected)} like the pictures before, got {_by(got)}"
    )


def _size(pixels: NDArray[np.uint8]) -> tuple[int, int]:
    return pixels.shape[1], pixels.shape[0]


def _by(size_px: tuple[int, int]) -> str:
    return f"{size_px[0]}x{size_px[1]}"
