"""Sample a square of the sensor from both streams: frames and a square -> a small RGB picture.

The streams are not merged into a picture of the whole field: a look takes its pixels from the ROI
where available and from the context elsewhere, at the tracker's input size.
"""

from dataclasses import dataclass, field
from typing import NoReturn

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline import Frame
from pipeline.errors import MessageError
from pipeline.pixel_formats import FORMATS

Picture = NDArray[np.uint8]
Rect = tuple[float, float, float, float]  # xyxy, sensor pixels
MEAN = np.array([0.485, 0.456, 0.406], np.float32) * 255  # of ImageNet, as both trackers have it
DEVIATION = np.array([0.229, 0.224, 0.225], np.float32) * 255
MARGIN_PX = 2  # picture pixels around a cut, for the interpolation at its edge


@dataclass(frozen=True, kw_only=True, eq=False)
class Streams:
    """The pictures of one exposure, and memory for looks."""

    context: Frame
    roi: Frame
    scratch: dict[int, Picture] = field(default_factory=dict)
    further: tuple[Frame, ...] = ()  # other windows of a sensor that reads several

    def look(self, centre: NDArray[np.float32], side_px: float, out_px: int) -> Picture:
        """A square of `side_px` sensor pixels around `centre` (x, y) as (out_px, out_px, 3) RGB.

        Valid until the next look of that size. Outside the field it is black.
        """
        if out_px not in self.scratch:
            self.scratch[out_px] = np.empty((out_px, out_px, 3), np.uint8)
        out, half = self.scratch[out_px], side_px / 2
        x, y = float(centre[0]), float(centre[1])
        square = (x - half, y - half, x + half, y + half)
        inside = common(square, self.roi.window)
        if common(square, middles(self.roi)) != square:  # beyond them a pixel has half a neighbour
            out[:] = 0
            draw(self.context, square, out)
            for frame in self.further:
                draw(frame, square, out)
        if inside[2] > inside[0] and inside[3] > inside[1]:
            draw(self.roi, square, out)
        return out


def size_of(box: NDArray[np.float32]) -> float:
    """Root of the area of a box (4,), at least 2 pixels."""
    width, height = box[2:] - box[:2]
    return float(max(np.sqrt(max(width * height, 0)), 2))


def normalise(look: Picture, out: NDArray[np.float32]) -> None:
    """RGB (h, w, 3) of 8 bit into a network input (1, 3, h, w) in place."""
    np.subtract(look.transpose(2, 0, 1), MEAN[:, None, None], out=out[0])
    out[0] /= DEVIATION[:, None, None]


def middles(frame: Frame) -> Rect:
    """The part of a window between the middles of its outermost pixels."""
    left, top, right, bottom = frame.window
    width, height = frame.size_px
    x, y = (right - left) / max(width, 1) / 2, (bottom - top) / max(height, 1) / 2
    return left + x, top + y, right - x, bottom - y


def common(a: Rect, b: tuple[float, float, float, float]) -> Rect:
    """What two rectangles share; right of left or below top when they share nothing."""
    return max(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), min(a[3], b[3])


def draw(frame: Frame, square: Rect, out: Picture) -> None:
    """Draw the part of `square` that `frame` shows into its place in `out`, bilinear.

    Nothing is drawn where the frame has no pixels. Raises `MessageError` for a packed frame.
    """
    if frame.packed and frame.pixels.size:
        refuse(frame.pixel_format)
    width, height = frame.size_px
    left, top, right, bottom = frame.window
    if not (height and width and right > left and bottom > top):
        return
    scale_x, scale_y = (right - left) / width, (bottom - top) / height  # sensor px per pixel
    x0, x1 = cut((square[0] - left) / scale_x, (square[2] - left) / scale_x, width)
    y0, y1 = cut((square[1] - top) / scale_y, (square[3] - top) / scale_y, height)
    if x1 - x0 < 3 or y1 - y0 < 3:
        return
    piece = rgb(frame.pixels[y0:y1, x0:x1], frame.pixel_format)
    step = (square[2] - square[0]) / out.shape[0]  # sensor px per pixel of the look
    zoom_x, zoom_y = step / scale_x, step / scale_y
    # pixel centres lie at halves: a look's pixel i shows the sensor at square[0] + (i + 0.5) * step
    shift_x = (square[0] - left + step / 2) / scale_x - 0.5 - x0
    shift_y = (square[1] - top + step / 2) / scale_y - 0.5 - y0
    cv2.warpAffine(
        piece,
        np.array([[zoom_x, 0, shift_x], [0, zoom_y, shift_y]]),
        (out.shape[1], out.shape[0]),
        dst=out,
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_TRANSPARENT,
    )


def cut(low: float, high: float, size: int) -> tuple[int, int]:
    """First and last pixel to take, with a margin, even so that a Bayer mosaic keeps its phase.

    >>> cut(3.2, 9.7, 100), cut(-50.0, 4.0, 5)
    ((0, 12), (0, 5))
    """
    first = max(int(np.floor(low)) - MARGIN_PX, 0)
    return first - first % 2, min(int(np.ceil(high)) + MARGIN_PX, size)


def rgb(pixels: NDArray[np.uint8] | NDArray[np.uint16], pixel_format: str) -> Picture:
    """A piece of a frame as (h, w, 3) RGB of 8 bit; itself when it is that already.

    A piece of a mosaic begins at even pixels of its frame; black level and white balance are those
    of an `operators.downsample` before this.
    """
    form = FORMATS.get(pixel_format)
    if pixel_format == "rgb8":
        return pixels.astype(np.uint8, copy=False)
    if form is None or form.packed or form.channels == 3:
        refuse(pixel_format)
    light = np.ascontiguousarray((pixels >> form.bits - 8).astype(np.uint8))
    how = f"COLOR_Bayer{form.order.upper()}2RGB" if form.order else "COLOR_GRAY2RGB"
    return np.asarray(cv2.cvtColor(light, getattr(cv2, how)), np.uint8)


def refuse(pixel_format: str) -> NoReturn:
    """Raise `MessageError` for a format that no piece can be cut from."""
    raise MessageError(
        f"tracker: expected pixels as rgb8, grey8 or an unpacked mosaic, got {pixel_format}; put "
        "operators.downsample before it"
    )
