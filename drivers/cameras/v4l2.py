"""Look at a V4L2 device before OpenCV does: a path in, its name or the reason why not out.

OpenCV says only that it cannot open a device. Numbers and structures are those of the kernel's
`linux/videodev2.h`.
"""

import errno
import fcntl
import grp
import os
import stat
import struct
from pathlib import Path

from pipeline.errors import DriverError
from pipeline.forecast import PictureStream
from pipeline.text import harmless

QUERYCAP, REQBUFS = 0x80685600, 0xC0145608  # _IOR('V', 0, 104 bytes), _IOWR('V', 8, 20 bytes)
CAPABILITY = struct.Struct("=16s32s32sIII12x")  # driver, card, bus, version, all and own abilities
CAPTURE, CAPTURE_MPLANE, META_CAPTURE, STREAMING = 0x1, 0x1000, 0x0080_0000, 0x0400_0000
HAS_DEVICE_CAPS = 0x8000_0000
CAPTURE_TYPE, MEMORY_MAPPED = 1, 1
# of a pixel, by fourcc (Linux media documentation, "Image Formats"); the others are compressed
BITS = {
    **dict.fromkeys(("YUYV", "UYVY", "YVYU", "VYUY", "Y16"), 16),
    **dict.fromkeys(("NV12", "NV21", "YU12", "YV12"), 12),
    **dict.fromkeys(("GREY", "RGGB", "GRBG", "GBRG", "BA81"), 8),
    **dict.fromkeys(("RGB3", "BGR3"), 24),
}
MOST_CHARS = 60  # of a name
NAMES = Path("/sys/class/video4linux")


class NoCamera(DriverError):
    """A video device that does not capture pictures."""


def path_of(device: int | str) -> str:
    """The path of a device by number or path.

    >>> path_of(2), path_of("/dev/v4l/by-id/usb-cam")
    ('/dev/video2', '/dev/v4l/by-id/usb-cam')
    """
    return f"/dev/video{device}" if isinstance(device, int) else device


def link_stream(fourcc: str, size_px: tuple[int, int], rate_hz: float) -> PictureStream:
    """What crosses the link in a V4L2 format; one that is compressed or not known has no bytes.

    >>> [link_stream(fourcc, (640, 480), 30).frame_bytes for fourcc in ("YUYV", "MJPG")]
    [614400, None]
    """
    bits = BITS.get(fourcc.strip())
    return PictureStream(
        size_px=size_px,
        pixel_format=fourcc.strip() or "any",
        frame_bytes=None if bits is None else -(-size_px[0] * size_px[1] * bits // 8),
        rate_hz=rate_hz,
    )


def look_at(path: str) -> str:
    """Return the name of a capture device; raises `DriverError` that says why it is none."""
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise DriverError(f"{path}: {why_not(path, error)}") from error
    try:
        name, can = _capabilities(path, descriptor)
        _check_free(path, descriptor)
    except OSError as error:
        raise DriverError(f"{path}: {why_not(path, error)}") from error
    finally:
        os.close(descriptor)
    if not can & (CAPTURE | CAPTURE_MPLANE):
        what = "carries data about pictures" if can & META_CAPTURE else "does not capture"
        raise NoCamera(f"{path}: expected a camera, got {name}, which {what}; {attached()}")
    if not can & STREAMING:
        raise NoCamera(f"{path}: expected a camera that streams, got {name}, which does not")
    return name


def why_not(path: str, error: OSError) -> str:
    """The reason of a failed open or request, in words of its cause.

    >>> why_not("/dev/video0", OSError(errno.EBUSY, "Device or resource busy"))
    'it is in use by another program'
    """
    code = error.errno
    if code in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
        return f"no such device; {attached()}"
    if code in (errno.EACCES, errno.EPERM):
        return f"no permission to open it; {_permission(path)}"
    if code == errno.EBUSY:
        return "it is in use by another program"
    if code in (errno.ENOTTY, errno.EINVAL, errno.EISDIR):
        return "expected a video device, got something else"
    return harmless(os.strerror(code or 0)).lower()


def attached() -> str:
    """Video devices of this host, for the end of a sentence."""
    found = numbers(NAMES)[:8]
    told = [f"/dev/video{number} ({_name_of(NAMES / f'video{number}')})" for number in found]
    return f"there is {', '.join(told)}" if told else "this host has no video device"


def numbers(names: Path) -> list[int]:
    """Numbers N of the devices /dev/videoN, ascending."""
    found = (entry.name.removeprefix("video") for entry in names.glob("video*"))
    return sorted(int(number) for number in found if number.isdecimal())


def _name_of(entry: Path) -> str:
    try:
        return harmless((entry / "name").read_text().strip(), MOST_CHARS)
    except OSError:
        return "no name"


def _capabilities(path: str, descriptor: int) -> tuple[str, int]:
    if not stat.S_ISCHR(os.fstat(descriptor).st_mode):
        raise OSError(errno.ENOTTY, "not a device", path)
    raw = bytearray(CAPABILITY.size)
    fcntl.ioctl(descriptor, QUERYCAP, raw)
    _, card, _, _, can, own = CAPABILITY.unpack(raw)
    if can & HAS_DEVICE_CAPS:  # a webcam has a second node, which carries no pictures
        can = own
    name = card.split(b"\0")[0].decode(errors="replace")
    return harmless(name.strip(), MOST_CHARS) or "a device without a name", can


def _check_free(path: str, descriptor: int) -> None:
    """Raise EBUSY where another program streams: to ask for no buffers changes nothing else."""
    request = bytearray(struct.pack("=III8x", 0, CAPTURE_TYPE, MEMORY_MAPPED))
    try:
        fcntl.ioctl(descriptor, REQBUFS, request)
    except OSError as error:
        if error.errno == errno.EBUSY:
            raise


def _permission(path: str) -> str:
    try:
        group = grp.getgrgid(os.stat(path).st_gid).gr_name
    except (OSError, KeyError):
        return "its owner must allow it"
    return f"its group is {group}: sudo usermod -aG {group} $USER, then log in again"
