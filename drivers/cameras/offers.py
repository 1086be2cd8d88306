"""What a V4L2 device offers: a path in; its formats with sizes and rates out.

Numbers and structures are those of the kernel's `linux/videodev2.h`. Nothing is set, so that a
device that another program uses can be asked as well.
"""

import fcntl
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass

from drivers.cameras.v4l2 import CAPTURE_TYPE, why_not
from pipeline.errors import DriverError

FORMATS, SIZES, INTERVALS = 0xC0405602, 0xC02C564A, 0xC034564B  # VIDIOC_ENUM_FMT, _FRAMESIZES, …
FORMAT = struct.Struct("=III32s4sI12x")  # index, type, flags, description, pixelformat, mbus
SIZE = struct.Struct("=I4sI6I8x")  # index, pixelformat, kind; sides, or their ranges and steps
INTERVAL = struct.Struct("=I4sIII6I8x")  # index, pixelformat, width, height, kind; fractions
DISCRETE = 1
MOST = 64  # of each list: a driver that goes on for ever does not stop this one


@dataclass(frozen=True, kw_only=True)
class WebcamOffer:
    """One format at one size."""

    fourcc: str
    size_px: tuple[int, int]  # width, height; the largest of a range; 0: not told
    rates_hz: tuple[float, ...] = ()  # highest first; of a range, the lowest and highest
    ranged: bool = False


def offers(path: str) -> tuple[WebcamOffer, ...]:
    """Return formats with sizes and rates in the device's order; raises `DriverError`."""
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise DriverError(f"{path}: {why_not(path, error)}") from error
    try:
        return tuple(
            _offer(descriptor, fourcc, size_px)
            for fourcc in _formats(descriptor)
            for size_px in _sizes(descriptor, fourcc)
        )
    finally:
        os.close(descriptor)


def _formats(descriptor: int) -> Iterator[bytes]:
    for index in range(MOST):
        asked = FORMAT.pack(index, CAPTURE_TYPE, 0, b"", b"", 0)
        if not (answer := _asked(descriptor, FORMATS, asked)):
            return
        yield FORMAT.unpack(answer)[4]


def _sizes(descriptor: int, fourcc: bytes) -> Iterator[tuple[int, int]]:
    for index in range(MOST):
        answer = _asked(descriptor, SIZES, SIZE.pack(index, fourcc, *[0] * 7))
        if not answer:
            if index == 0:  # the driver does not tell sizes
                yield 0, 0
            return
        kind, *numbers = SIZE.unpack(answer)[2:]
        if kind != DISCRETE:  # least, largest and step of each side
            yield numbers[1], numbers[4]
            return
        yield numbers[0], numbers[1]


def _offer(descriptor: int, fourcc: bytes, size_px: tuple[int, int]) -> WebcamOffer:
    rates: list[float] = []
    name = fourcc.decode("latin-1").strip()
    shown = name if name.isascii() and name.isprintable() else f"0x{fourcc[::-1].hex()}"
    for index in range(MOST):
        answer = _asked(descriptor, INTERVALS, INTERVAL.pack(index, fourcc, *size_px, *[0] * 7))
        if not answer:
            break
        kind, first, second, third, fourth = INTERVAL.unpack(answer)[4:9]
        if kind != DISCRETE:  # the shortest and the longest interval
            ends = tuple(sorted(filter(None, (_rate(first, second), _rate(third, fourth)))))
            return WebcamOffer(fourcc=shown, size_px=size_px, rates_hz=ends, ranged=True)
        rates.append(_rate(first, second))
    listed = tuple(sorted(filter(None, rates), reverse=True))
    return WebcamOffer(fourcc=shown, size_px=size_px, rates_hz=listed)


def _rate(numerator: int, denominator: int) -> float:
    """Frames per second of an interval in seconds; 0: it is none.

    >>> _rate(1001, 30000), _rate(0, 1)
    (29.97, 0.0)
    """
    return round(denominator / numerator, 3) if numerator else 0.0


def _asked(descriptor: int, request: int, given: bytes) -> bytes:
    """The structure as the driver fills it; empty where the list ends."""
    memory = bytearray(given)
    try:
        fcntl.ioctl(descriptor, request, memory)
    except OSError:
        return b""
    return bytes(memory)
