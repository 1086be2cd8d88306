"""Cut a camera's whole picture: pixels of any format in, RGB context and RGB ROI out.

Only what is cut is converted: the context is averaged in the camera's own format and then made
RGB, the ROI is cropped and then made RGB. A full-size RGB picture never exists.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.commands import Window
from drivers.readout import average
from pipeline import pixel_formats
from pipeline.errors import DriverError

# OpenCV names a Bayer pattern by the second row's second and third pixel
_DEMOSAIC = {
    "rggb": cv2.COLOR_BayerBG2RGB,
    "grbg": cv2.COLOR_BayerGB2RGB,
    "gbrg": cv2.COLOR_BayerGR2RGB,
    "bggr": cv2.COLOR_BayerRG2RGB,
}
FORMATS = tuple(name for name, form in pixel_formats.FORMATS.items() if not form.packed)
MOSAICS = tuple(name for name in FORMATS if pixel_formats.FORMATS[name].order)
MARGIN_PX = 2  # neighbours that the colours at the edge of a crop are interpolated from


class Cutter:
    """Cuts pictures of one format, with scratch memory of at most a ROI's or a context's size.

    Of samples of more than 8 bits the upper 8 are what is shown. The sides of a mosaic must be
    even, and so must the corner of a window on it.
    """

    def __init__(self, pixel_format: str, size_px: tuple[int, int]) -> None:
        if pixel_format not in FORMATS:
            raise DriverError(f"pixels: expected {', '.join(FORMATS)}, got {pixel_format!r}")
        if not all(side >= 1 for side in size_px):
            raise DriverError(f"picture: expected sides of at least 1, got {_by(size_px)}")
        form = pixel_formats.FORMATS[pixel_format]
        self._format, self._size_px = pixel_format, size_px
        self._channels, self._order, self._dtype = form.channels, form.order, np.dtype(form.dtype)
        self._shift = form.bits - 8
        self.mosaic = bool(form.order)
        if self.mosaic and any(side % 2 or side < 4 for side in size_px):
            got = f"{_by(size_px)} of {pixel_format}"
            raise DriverError(f"picture: a mosaic needs even sides of at least 4, got {got}")
        self._scratch: dict[str, NDArray[Any]] = {}

    @property
    def multiple_px(self) -> int:
        """Sides and steps of windows: whole cells of a mosaic."""
        return 2 if self.mosaic else 1

    def check(self, pixels: NDArray[Any]) -> None:
        """Raise `DriverError` unless a picture is what was negotiated."""
        width, height = self._size_px
        wanted = (height, width) if self._channels == 1 else (height, width, self._channels)
        if pixels.shape != wanted or pixels.dtype != self._dtype:
            raise DriverError(
                f"picture: expected {self._format} of {_by(self._size_px)} as at the start, got "
                f"{pixels.dtype} of {'x'.join(str(side) for side in pixels.shape)}"
            )

    def context(self, pixels: NDArray[Any], out: NDArray[np.uint8]) -> None:
        """Fill `out` (h, w, 3) with area means of the whole picture."""
        if self.mosaic:
            self._mosaic_context(pixels, out)
        elif self._format == "rgb8":
            average(pixels, out)
        else:
            small = self._memory("context", (*out.shape[:2], *pixels.shape[2:]), pixels.dtype)
            average(pixels, small)
            self._colour(small, out)

    def roi(self, pixels: NDArray[Any], window: Window, out: NDArray[np.uint8]) -> None:
        """Fill `out` (h, w, 3) with a window of the picture, averaged where `out` is smaller."""
        left, top, right, bottom = window
        crop = self._demosaic(pixels, window) if self.mosaic else pixels[top:bottom, left:right]
        if crop.shape[:2] != out.shape[:2]:
            crop = self._averaged(crop, out.shape[:2])
        if self.mosaic or self._format == "rgb8":
            np.copyto(out, crop)
        else:
            self._colour(crop, out)

    def _averaged(self, crop: NDArray[Any], size: tuple[int, ...]) -> NDArray[Any]:
        found = self._memory("roi", (*size, *crop.shape[2:]), crop.dtype)
        average(crop, found)
        return found

    def _colour(self, pixels: NDArray[Any], out: NDArray[np.uint8]) -> None:
        code = cv2.COLOR_BGR2RGB if self._channels == 3 else cv2.COLOR_GRAY2RGB
        cv2.cvtColor(self._eight_bits(pixels, "eight"), code, dst=out)

    def _demosaic(self, pixels: NDArray[Any], window: Window) -> NDArray[np.uint8]:
        """The window in RGB, interpolated from a crop that is a margin larger."""
        left, top, right, bottom = window
        width, height = self._size_px
        x0, y0 = max(0, left - MARGIN_PX), max(0, top - MARGIN_PX)
        x1, y1 = min(width, right + MARGIN_PX), min(height, bottom + MARGIN_PX)
        crop = self._eight_bits(pixels[y0:y1, x0:x1], "eight")
        colours = self._memory("colours", (*crop.shape, 3), np.uint8)
        cv2.cvtColor(crop, _DEMOSAIC[self._order], dst=colours)
        return colours[top - y0 : bottom - y0, left - x0 : right - x0]

    def _mosaic_context(self, pixels: NDArray[Any], out: NDArray[np.uint8]) -> None:
        """Average the colours one by one: every second row is a picture of two channels."""
        width, height = self._size_px
        sums: dict[str, list[NDArray[np.uint8]]] = {"r": [], "g": [], "b": []}
        for row in (0, 1):
            cells = pixels[row::2].reshape(height // 2, width // 2, 2)
            means = self._memory(f"row{row}", (*out.shape[:2], 2), pixels.dtype)
            average(cells, means)
            eight = self._eight_bits(means, f"eight{row}")
            for column in (0, 1):
                sums[self._order[2 * row + column]].append(eight[..., column])
        out[..., 0], out[..., 2] = sums["r"][0], sums["b"][0]
        out[..., 1] = cv2.addWeighted(sums["g"][0], 0.5, sums["g"][1], 0.5, 0)

    def _eight_bits(self, pixels: NDArray[Any], name: str) -> NDArray[np.uint8]:
        if pixels.dtype == np.uint8:
            return pixels
        out = self._memory(name, pixels.shape, np.uint8)
        np.right_shift(pixels, self._shift, out=out, casting="unsafe")
        return out

    def _memory(self, name: str, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
        found = self._scratch.get(name)
        if found is None or found.shape != shape or found.dtype != dtype:
            found = self._scratch[name] = np.empty(shape, dtype)
        return found


def _by(size_px: tuple[int, ...]) -> str:
    return "x".join(str(side) for side in size_px)
