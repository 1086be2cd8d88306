"""Eq. 1 on one picture: a full-resolution RGB picture in, context D(v) and ROI C(v) out.

D averages areas, C crops; both write into the memory they are given. A raw sensor's mosaic, its
noise and its packing are added on the way when asked for.
"""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import DTypeLike, NDArray

from drivers.commands import Window
from drivers.mosaic import to_mosaic, write_samples
from drivers.noise import NO_NOISE, OFFSETS, Response, normal_table, stretch
from drivers.readout import average
from drivers.simulated.windows import Picture, WindowedPicture
from pipeline.pixel_formats import FORMATS, PixelFormat


class Readout:
    """Reads regions of at most `most_px` pixels, with scratch memory for what needs a detour.

    `form` is rgb8 or a mosaic in the order of the sensor's first pixel; `noise` is a standard
    deviation in digital numbers of 8 bit, added whatever the light.
    """

    def __init__(
        self,
        *,
        form: PixelFormat = FORMATS["rgb8"],
        noise: float = 0.0,
        response: Response | None = None,
        seed: int,
        most_px: int,
    ) -> None:
        self._form, self._noise, self._seed = form, noise, seed
        self._response = response or Response(bits=form.bits)
        self._scratch: dict[tuple[int, str], NDArray[Any]] = {}
        # now, since the first exposure cannot wait for it
        if noise:
            self._table = noise_table(noise, most_px * form.channels + OFFSETS, seed)
        if self._response.full_well_e:
            self._normal = normal_table(most_px + OFFSETS, seed)

    @property
    def dtype(self) -> DTypeLike:
        """Of the arrays that pictures fill."""
        return self._form.dtype

    def shape(self, size_px: tuple[int, int]) -> tuple[int, ...]:
        """Shape of the array that a picture of this width and height fills."""
        return self._form.shape(size_px)

    def form_of(self, window: Window, size_px: tuple[int, int]) -> PixelFormat:
        """The format of a read-out: a crop's mosaic begins at the colour of the window's corner.

        One that is averaged has a mosaic of its own, in the sensor's order.
        """
        left, top, right, bottom = window
        cropped = (right - left, bottom - top) == size_px
        return self._form.shifted(left, top) if cropped else self._form

    def read(
        self,
        picture: Picture,
        window: Window,
        out: NDArray[Any],
        *,
        seq: int,
        port: int,
    ) -> None:
        """Fill `out` with `window` of the picture; `port` tells the two streams' noise apart."""
        width, height = self._form.size_px(out.shape)
        form = self.form_of(window, (width, height))
        raw = bool(form.order)
        shape = (height, width, 3)
        region = shown(
            picture, window, shape, lambda: self._memory(port, "rgb", shape) if raw else out
        )
        if not raw:
            if region is not out:
                np.copyto(out, region)
            if self._noise:
                self._add_noise(out, seq, port)
            return
        direct = form.name.endswith("8") and self._response.plain
        mosaic = out if direct else self._memory(port, "mosaic", (height, width))
        to_mosaic(region, form.order, mosaic)
        if self._noise:
            self._add_noise(mosaic, seq, port)
        if not direct:
            normal = NO_NOISE
            if self._response.full_well_e:
                normal = stretch(self._normal, mosaic.shape, (self._seed, seq, port, 1))
            numbers = self._memory(port, "numbers", (height, 2 * width)).view(np.uint16)
            write_samples(self._response.expose(mosaic, normal, numbers), form, out)

    def _memory(self, port: int, name: str, shape: tuple[int, ...]) -> NDArray[np.uint8]:
        found = self._scratch.get((port, name))
        if found is None or found.shape != shape:
            found = self._scratch[port, name] = np.empty(shape, np.uint8)
        return found

    def _add_noise(self, out: NDArray[np.uint8], seq: int, port: int) -> None:
        noise = stretch(self._table, out.shape, (self._seed, seq, port))
        cv2.add(out, noise, out, None, cv2.CV_8U)


def shown(
    picture: Picture,
    window: Window,
    shape: tuple[int, int, int],
    memory: Callable[[], NDArray[np.uint8]],
) -> NDArray[np.uint8]:
    """Return a window of the picture of this shape: a view, or else made in `memory`."""
    left, top, right, bottom = window
    if isinstance(picture, WindowedPicture):
        made = memory()
        picture.read(window, made)
        return made
    region = picture[top:bottom, left:right]
    if region.shape == shape:
        return region
    made = memory()
    average(region, made)
    return made


def noise_table(deviation: float, size: int, seed: int) -> NDArray[np.int16]:
    """Normal noise (size,) in whole digital numbers; each picture shows another stretch of it.

    Drawing every picture anew costs ten times as much as all the rest of the read-out.
    """
    drawn = np.random.default_rng(seed).standard_normal(size, np.float32)
    return np.asarray(np.rint(np.clip(drawn * deviation, -255, 255)), np.int16)
