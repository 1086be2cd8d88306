"""Read a camera with OpenCV's VideoCapture: a device path, URL or pipeline in, BGR frames out."""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.cameras.newest import Connection
from pipeline.errors import DriverError
from pipeline.pixel_formats import FORMATS, PixelFormat

V4L2, FFMPEG, GSTREAMER = cv2.CAP_V4L2, cv2.CAP_FFMPEG, cv2.CAP_GSTREAMER
NAMES = {V4L2: "V4L2", FFMPEG: "FFmpeg", GSTREAMER: "GStreamer"}
MOST_HZ = 1000.0  # a rate beyond it is the time base of a container, not a rate
RAW = {  # mosaics by the names of linux/videodev2.h, least significant bits first in uint16
    "BA81": "bayer_bggr8", "GBRG": "bayer_gbrg8", "GRBG": "bayer_grbg8", "RGGB": "bayer_rggb8",
    "BG10": "bayer_bggr10", "GB10": "bayer_gbrg10", "BA10": "bayer_grbg10", "RG10": "bayer_rggb10",
    "BG12": "bayer_bggr12", "GB12": "bayer_gbrg12", "BA12": "bayer_grbg12", "RG12": "bayer_rggb12",
    "BG14": "bayer_bggr14", "GB14": "bayer_gbrg14", "GR14": "bayer_grbg14", "RG14": "bayer_rggb14",
    "BYR2": "bayer_bggr16", "GB16": "bayer_gbrg16", "GR16": "bayer_grbg16", "RG16": "bayer_rggb16",
}  # fmt: skip
START_OF_IMAGE, END_OF_IMAGE = b"\xff\xd8", b"\xff\xd9"  # ITU-T T.81, table B.1
SOON = 0.9  # share of a timeout after which a failed read counts as a timeout


@dataclass(frozen=True, kw_only=True)
class Told:
    """What the device or stream says of itself; empty and 0 where it does not."""

    backend: str = ""
    fourcc: str = ""
    rate_hz: float = 0.0
    length: int = 0  # frames; a live stream has none
    pixel_format: str = ""  # of a mosaic; empty: what OpenCV makes of it tells


def version() -> str:
    """Version of OpenCV, for a sentence about it."""
    return str(cv2.__version__)


def has(backend: int) -> bool:
    """Whether this build of OpenCV can use a backend, from itself or from a plug-in."""
    return bool(cv2.videoio_registry.hasBackend(backend))


def fourcc_of(code: float) -> str:
    """Four characters from their number; empty unless they are printable.

    >>> fourcc_of(1196444237.0), fourcc_of(0.0), fourcc_of(float("nan"))
    ('MJPG', '', '')
    """
    if not math.isfinite(code) or not 0 < code < 1 << 32:
        return ""
    text = int(code).to_bytes(4, "little").decode("latin-1").strip()
    return text if text.isascii() and text.isprintable() else ""


class OpenCvConnection(Connection):
    """A `Connection` over a VideoCapture that is open.

    Only a V4L2 device can be asked to wait for a while; the other backends wait in C++ until a
    frame comes or `read_timeout_s` is over.
    """

    def __init__(self, capture: cv2.VideoCapture, *, name: str, read_timeout_s: float) -> None:
        self._capture, self._name, self._timeout_s = capture, name, read_timeout_s
        self._backend = int(capture.get(cv2.CAP_PROP_BACKEND))
        self._jpeg = False  # a frame is the bytes of a JPEG
        self._raw: PixelFormat | None = None  # a frame is a mosaic

    def told(self) -> Told:
        """What it says of itself now."""
        get = self._capture.get
        rate_hz = get(cv2.CAP_PROP_FPS)
        length = get(cv2.CAP_PROP_FRAME_COUNT) if self._backend == FFMPEG else 0.0
        return Told(
            backend=NAMES.get(self._backend, "OpenCV"),
            fourcc=fourcc_of(get(cv2.CAP_PROP_FOURCC)),
            rate_hz=float(rate_hz) if 0 < rate_hz <= MOST_HZ else 0.0,
            length=max(0, int(length)) if math.isfinite(length) else 0,
            pixel_format=self._raw.name if self._raw else "",
        )

    def wait(self, timeout_s: float) -> bool:
        """Wait for a frame; raises `DriverError` when it was lost, has ended or is silent."""
        if self._backend == V4L2:
            return self._poll(timeout_s)
        begun_s = time.monotonic()
        grabbed = self._capture.grab()
        waited_s = time.monotonic() - begun_s
        if waited_s >= SOON * self._timeout_s:  # a frame that comes then is the decoder's last one
            raise DriverError(f"{self._name}: it sent nothing for {waited_s:.1f} s")
        if grabbed:
            return True
        raise DriverError(f"{self._name}: the stream ended")

    def decode(self, into: NDArray[Any] | None) -> NDArray[Any] | None:
        """The frame in BGR (h, w, 3) or grey (h, w); None where it is empty or damaged."""
        try:
            done, pixels = self._capture.retrieve(into)
        except cv2.error:
            return None
        if not done or pixels is None or not pixels.size:
            return None
        found = np.asarray(pixels)
        if self._jpeg:
            return self._of_size(decoded(np.asarray(found, np.uint8).reshape(-1)))
        if self._raw is not None:
            return self._mosaic(found, self._raw)
        return found[..., 0] if found.ndim == 3 and found.shape[2] == 1 else found

    def ask(self, *, size_px: tuple[int, int], rate_hz: float, fourcc: str) -> None:
        """Ask a V4L2 device for a format; it may choose another, which `told` and frames say."""
        capture = self._capture
        if fourcc:
            capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*fourcc))
        if size_px != (0, 0):  # the first of both waits for the second
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, size_px[0])
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size_px[1])
        if rate_hz:
            capture.set(cv2.CAP_PROP_FPS, rate_hz)
        chosen = self.told().fourcc
        if chosen in ("MJPG", "JPEG"):  # OpenCV's own decoding hides damaged frames
            self._jpeg = bool(capture.set(cv2.CAP_PROP_CONVERT_RGB, 0))
        elif chosen in RAW and capture.set(cv2.CAP_PROP_CONVERT_RGB, 0):
            self._raw = FORMATS[RAW[chosen]]

    def close(self) -> None:
        """Release device or connection."""
        self._capture.release()

    def _size(self) -> tuple[int, int]:
        """Width and height that the device tells; 0 where it does not."""
        get = self._capture.get
        return int(get(cv2.CAP_PROP_FRAME_WIDTH)), int(get(cv2.CAP_PROP_FRAME_HEIGHT))

    def _of_size(self, found: NDArray[np.uint8] | None) -> NDArray[np.uint8] | None:
        """The picture of a JPEG; None for damage that has changed its size."""
        expected = self._size()
        if found is None or (all(expected) and found.shape[1::-1] != expected):
            return None
        return found

    def _mosaic(self, found: NDArray[Any], form: PixelFormat) -> NDArray[Any]:
        """The bytes of a frame as (h, w) samples; raises `DriverError` for rows with padding."""
        width, height = self._size()
        expected = form.row_bytes(width) * height
        if found.nbytes != expected:
            raise DriverError(
                f"{self._name}: expected {expected} bytes of {width}x{height} {form.name}, got "
                f"{found.nbytes}"
            )
        return found.reshape(-1).view(form.dtype).reshape(height, width)

    def _poll(self, timeout_s: float) -> bool:
        try:
            ready, _ = cv2.VideoCapture.waitAny([self._capture], int(timeout_s * 1e9))
        except cv2.error as error:  # its poll says POLLERR
            raise DriverError(f"{self._name}: the device does not deliver any more") from error
        return bool(ready)


def decoded(jpeg: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """A JPEG (n,) in BGR (h, w, 3); None when its end is missing or it cannot be decoded.

    >>> decoded(np.zeros(9, np.uint8)) is None
    True
    """
    data = jpeg.tobytes()
    if not data.startswith(START_OF_IMAGE) or END_OF_IMAGE not in data:
        return None
    try:
        found = cv2.imdecode(jpeg, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:  # damage can make it larger than OpenCV allows
        return None
    return None if found is None or not found.size else np.asarray(found, np.uint8)


def connect(
    place: str, backend: int, *, name: str, parameters: Mapping[int, int], read_timeout_s: float
) -> OpenCvConnection | None:
    """Open a path, URL or pipeline with one backend; None where OpenCV cannot, without a reason."""
    flat = [int(value) for pair in parameters.items() for value in pair]
    try:
        capture = cv2.VideoCapture(place, backend, flat)
    except cv2.error:
        return None
    if not capture.isOpened():
        return None
    return OpenCvConnection(capture, name=name, read_timeout_s=read_timeout_s)


def stream_parameters(*, open_timeout_s: float, read_timeout_s: float) -> dict[int, int]:
    """Limits of waiting on a network, for FFmpeg and GStreamer."""
    return {
        cv2.CAP_PROP_OPEN_TIMEOUT_MSEC: round(open_timeout_s * 1000),
        cv2.CAP_PROP_READ_TIMEOUT_MSEC: round(read_timeout_s * 1000),
    }


def decoder_parameters(threads: int) -> dict[int, int]:
    """Threads of FFmpeg's decoder: each one more delays a picture by a frame."""
    return {cv2.CAP_PROP_N_THREADS: threads}
