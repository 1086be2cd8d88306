"""Frames as JPEG, and what a context shows of the window of an ROI."""

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.errors import MessageError
from pipeline.messages import Frame
from pipeline.pixel_formats import FORMATS


def jpeg(frame: Frame, quality: int) -> bytes:
    """A frame as JPEG; raises `MessageError` for a pixel format that cannot be shown as it is."""
    return encoded(_colours(frame), quality)


def jpeg_within(frame: Frame, quality: int, most_px: int) -> tuple[bytes, tuple[int, int]]:
    """A frame as JPEG at most `most_px` wide, averaged if it is wider, and its size in pixels."""
    pixels = _colours(frame)
    height, width = pixels.shape[:2]
    shrink = -(-width // most_px)
    size_px = max(1, width // shrink), max(1, height // shrink)
    if shrink > 1:
        pixels = np.asarray(cv2.resize(pixels, size_px, interpolation=cv2.INTER_AREA), np.uint8)
    return encoded(pixels, quality), size_px


def encoded(pixels: NDArray[np.uint8], quality: int) -> bytes:
    """Return BGR (h, w, 3) or grey (h, w) pixels as JPEG."""
    _, contents = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return contents.tobytes()


def same_window(
    context: Frame, window: tuple[int, int, int, int], size_px: tuple[int, int]
) -> NDArray[np.uint8]:
    """Return a window of the sensor as the context shows it: (height, width[, 3]), BGR or grey.

    Its pixels are enlarged to the `size_px` asked for, not smoothed; outside the context is black.
    """
    pixels = _colours(context)
    height, width = pixels.shape[:2]
    left, top, right, bottom = context.window
    across, down = (right - left) / width, (bottom - top) / height  # sensor pixels in one of these
    columns = _nearest(window[0] - left, window[2] - left, size_px[0], across)
    rows = _nearest(window[1] - top, window[3] - top, size_px[1], down)
    shown = pixels[rows.clip(0, height - 1)][:, columns.clip(0, width - 1)]
    shown[(rows < 0) | (rows >= height)] = 0
    shown[:, (columns < 0) | (columns >= width)] = 0
    return np.asarray(shown, np.uint8)


def _nearest(start: float, end: float, count: int, step: float) -> NDArray[np.intp]:
    """Return which pixel of size `step` is under each of `count` places from start to end."""
    places = start + (np.arange(count) + 0.5) * (end - start) / count
    return np.floor(places / step).astype(np.intp)


def _colours(frame: Frame) -> NDArray[np.uint8]:
    form = FORMATS.get(frame.pixel_format)
    if form is None or form.packed:
        raise MessageError(
            f"visualise: expected pixels as rgb8, grey8 or an unpacked mosaic, got "
            f"{frame.pixel_format}; put operators.downsample before it"
        )
    form.check("visualise", frame.pixels)
    pixels = frame.pixels
    if form.bits > 8:
        pixels = (pixels >> form.bits - 8).astype(np.uint8)
    if form.order:
        how = getattr(cv2, f"COLOR_Bayer{form.order.upper()}2BGR")
        pixels = np.asarray(cv2.cvtColor(pixels, how), np.uint8)
    elif form.name == "rgb8":
        pixels = np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), np.uint8)
    return np.asarray(pixels, np.uint8)
