"""Check what a source of one's own says and gives: a sentence names it, and not its user."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.source import Annotations, FrameSource
from pipeline.errors import DriverError

MOST_PX = 1 << 16  # of a side


def check_source(source: FrameSource) -> None:
    """Raise `DriverError` unless size, rate and length are what a `FrameSource` has."""
    size_px: Any = getattr(source, "size_px", None)
    whole = isinstance(size_px, tuple) and len(size_px) == 2 and all(map(_is_whole, size_px))
    if not whole or not all(1 <= side <= MOST_PX for side in size_px):
        raise _wrong(source, "size_px", f"two whole numbers of 1 to {MOST_PX}", size_px)
    rate_hz: Any = getattr(source, "rate_hz", None)
    if not isinstance(rate_hz, (int, float)) or not 0 <= rate_hz < math.inf:
        raise _wrong(source, "rate_hz", "a finite number from 0 on", rate_hz)
    length: Any = getattr(source, "length", "nothing")
    if length is not None and not (_is_whole(length) and length >= 0):
        raise _wrong(source, "length", "a whole number from 0 on, or None", length)


def checked_picture(source: FrameSource, index: int) -> NDArray[np.uint8]:
    """Return frame `index`; raises `DriverError` for one of another shape or type."""
    found: Any = source.picture(index)
    shape = (source.size_px[1], source.size_px[0], 3)
    if not isinstance(found, np.ndarray) or (found.shape, found.dtype) != (shape, np.uint8):
        got = f"{found.dtype} {found.shape}" if isinstance(found, np.ndarray) else repr(found)[:60]
        raise _wrong(source, f"picture {index}", f"uint8 {shape}", got)
    return found


def checked_truth(source: FrameSource, index: int) -> Annotations | None:
    """Return what is in frame `index`; raises `DriverError` for anything else."""
    found: Any = source.truth(index)
    if found is not None and not isinstance(found, Annotations):
        raise _wrong(source, f"truth {index}", "Annotations or None", type(found).__name__)
    return found


def _is_whole(value: object) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def _wrong(source: FrameSource, what: str, expected: str, got: object) -> DriverError:
    cls = type(source)
    name = f"{cls.__module__}:{cls.__qualname__}"
    return DriverError(f"{name}: {what}: expected {expected}, got {str(got)[:60]}")
