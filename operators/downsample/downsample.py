"""Prepare frames for networks: Frame of any pixel format -> Frame, 8-bit RGB.

A raw frame is unpacked, its black level subtracted, its colours balanced and, where it keeps its
size, demosaiced. At half its width or less its samples are averaged in the mosaic: no full-size RGB
picture is made on the way.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.samples import STRIP, Samples
from operators.downsample.binning import Binning, can_bin
from operators.downsample.tone import Curve, Gains, Levels, Tone
from operators.downsample.white_balance import Balance, grey_world
from pipeline.contract import Input, Operator
from pipeline.errors import MessageError, SettingsError
from pipeline.forecast import Forecast, Upstream, pictures
from pipeline.messages import Frame, Header
from pipeline.pixel_formats import PixelFormat, pixel_format

T = TypeVar("T")
LEAST_MOSAIC_PX = 3  # a side; OpenCV interpolates no smaller one


@dataclass(frozen=True, kw_only=True)
class DownsampleSettings:
    """What a graph may set; everything but the width is for raw and grey frames."""

    width_px: int = 0  # 0: keep the size
    black_level: int = 0  # what the sensor counts in the dark
    white_level: int = 0  # what it counts at most; 0: the format's largest number
    gains: Gains = (1.0, 1.0, 1.0)  # of red, green and blue
    # fixed: the gains; grey_world: measured on these frames; reference: on those of that input
    white_balance: Literal["fixed", "grey_world", "reference"] = "fixed"
    adaptation: float = 0.1  # weight of a new frame in measured gains
    gamma: float = 1.0  # 2.2 or so for a sensor that counts light

    def __post_init__(self) -> None:
        for name in ("width_px", "black_level", "white_level"):
            if getattr(self, name) < 0:
                raise SettingsError(f"{name}: must be at least 0, got {getattr(self, name)}")
        if self.white_level and self.white_level <= self.black_level:
            raise SettingsError(
                f"white_level: expected above the black level {self.black_level}, "
                f"got {self.white_level}"
            )
        for gain in self.gains:
            if not 0 < gain <= 64:
                raise SettingsError(f"gains: expected above 0 to 64, got {gain}")
        if not 0 < self.adaptation <= 1:
            raise SettingsError(f"adaptation: expected above 0 to 1, got {self.adaptation}")
        if not 0.1 <= self.gamma <= 10:
            raise SettingsError(f"gamma: expected 0.1 to 10, got {self.gamma}")


class Downsample(Operator[DownsampleSettings, Frame]):
    """Develop raw frames, shrink by area, never enlarge; keep header, window and status.

    An RGB frame that already fits passes unchanged, and so does an empty picture (no ROI).
    `reference` is a raw stream of the same sensor to take the white balance from: an ROI's own mean
    changes with what it looks at.
    """

    frame = Input(Frame, keep="latest")
    reference = Input(Frame, keep="latest", join=False, optional=True)
    live = ("black_level", "white_level", "gains", "adaptation", "gamma")

    @classmethod
    def advise(cls, settings: DownsampleSettings, upstream: Mapping[str, Any]) -> Iterable[str]:
        """Raises `SettingsError` where the white balance has nothing to refer to."""
        if settings.white_balance == "reference" and "reference" not in upstream:
            raise SettingsError("white_balance: expected the input reference connected, got none")
        return ()

    @classmethod
    def forecast(cls, settings: DownsampleSettings, upstream: Upstream) -> Forecast:
        """Return the stream that follows from the one it reads, where that is known."""
        taken = upstream.streams.get("frame")
        if taken is None:
            return Forecast()
        height, width = fitted((taken.size_px[1], taken.size_px[0]), settings.width_px)
        return Forecast(streams={"out": pictures((width, height), "rgb8", taken.rate_hz)})

    def open(self) -> None:
        """Allocate nothing yet: sizes are known with the first frame."""
        self._balance = Balance()
        self._curve = Curve(self.settings.gamma)
        self._forget()

    def on_stream(self, header: Header) -> None:
        """Another sensor: another light."""
        self._balance = Balance()

    def on_settings(self, settings: DownsampleSettings) -> None:
        """Use new levels from the next frame on."""
        super().on_settings(settings)
        self._curve = Curve(settings.gamma)
        self._forget()

    def state(self) -> Balance:
        """The measured white balance."""
        return self._balance

    def restore(self, state: Balance) -> None:
        """Go on with a predecessor's white balance."""
        self._balance = state

    def on_reference(self, reference: Frame) -> None:
        """Measure the white balance here rather than on the frames themselves."""
        if self.settings.white_balance == "reference":
            self._measure(reference, pixel_format(reference.pixel_format, "reference"))

    def on_frame(self, frame: Frame) -> Frame:
        """Return a frame for each frame; raises `MessageError` for one that is not what it says."""
        form = pixel_format(frame.pixel_format, "frame")
        form.check("frame", frame.pixels)
        if not frame.pixels.size:
            return replace(frame, pixels=np.empty((0, 0, 3), np.uint8), pixel_format="rgb8")
        if self.settings.white_balance == "grey_world":
            self._measure(frame, form)
        size = frame.size_px
        height, width = fitted((size[1], size[0]), self.settings.width_px)
        if form.name == "rgb8" and (width, height) == size:
            return frame
        out = self.loan((height, width, 3), np.uint8)
        if form.channels == 3:
            shrink(np.asarray(frame.pixels, np.uint8), out)
            if form.name == "bgr8":
                cv2.cvtColor(out, cv2.COLOR_BGR2RGB, out)
        elif form.order and can_bin(size, (width, height)):
            means = self._binning(form, size, (width, height))(frame.pixels)
            self._tone(form, size[0]).superpixels(means, out)
        else:
            self._develop(frame, form, out)
        return replace(frame, pixels=out, pixel_format="rgb8")

    def _develop(self, frame: Frame, form: PixelFormat, out: NDArray[np.uint8]) -> None:
        """Every pixel at full size, then shrunk if it must be."""
        width, height = frame.size_px
        light = self._light(frame, form)
        if not form.order:
            small = self._memory("grey", out.shape[:2])
            shrink(light, small)
            cv2.cvtColor(small, cv2.COLOR_GRAY2RGB, out)
        elif (height, width) == out.shape[:2]:
            demosaic(light, form.order, out)
        else:
            whole = self._memory("rgb", (height, width, 3))
            demosaic(light, form.order, whole)
            shrink(whole, out)

    def _light(self, frame: Frame, form: PixelFormat) -> NDArray[np.uint8]:
        """The samples (h, w) as 8 bit, of balanced colours."""
        width, height = frame.size_px
        tone = self._tone(form, width)
        if self._curve.linear and self._levels(form).plain(form):
            return np.asarray(frame.pixels, np.uint8)
        light, read = self._memory("light", (height, width)), self._samples(form, width)
        for top in range(0, height, STRIP):
            tone.strip(read(frame.pixels[top : top + STRIP]), light[top : top + STRIP])
        return light

    def _levels(self, form: PixelFormat) -> Levels:
        """Levels for this format; raises `MessageError` where they leave no range."""
        s = self.settings
        white = s.white_level or form.white
        if not s.black_level < white <= form.white:
            raise MessageError(
                f"frame: expected black and white level within 0..{form.white} of {form.name}, "
                f"got {s.black_level} and {white}"
            )
        gains = s.gains
        if s.white_balance != "fixed" and self._balance.frames:
            gains = self._balance.gains
        return Levels(black=s.black_level, white=white, gains=gains)

    def _measure(self, frame: Frame, form: PixelFormat) -> None:
        form.check("frame", frame.pixels)
        if not form.order or not frame.pixels.size:
            return
        levels = self._levels(form)
        seen = grey_world(
            frame.pixels, form, frame.size_px[0], black=levels.black, white=levels.white
        )
        if seen is not None:
            self._balance = self._balance.towards(seen, self.settings.adaptation)

    def _binning(self, form: PixelFormat, size: tuple[int, int], out: tuple[int, int]) -> Binning:
        return self._kept("binning", (form, size, out), lambda: Binning(form, size, out))

    def _samples(self, form: PixelFormat, width: int) -> Samples:
        return self._kept("samples", (form, width), lambda: Samples(form, width))

    def _tone(self, form: PixelFormat, width: int) -> Tone:
        levels = self._levels(form)
        make = partial(Tone, form, width, levels, self._curve)
        return self._kept("tone", (form, width, levels), make)

    def _memory(self, name: str, shape: tuple[int, ...]) -> NDArray[np.uint8]:
        return self._kept(name, shape, lambda: np.empty(shape, np.uint8))

    def _kept(self, name: str, key: object, make: Callable[[], T]) -> T:
        """What was made for the last frame, if it suits this one, else made anew."""
        found = self._made.get(name)
        if found is None or found[0] != key:
            found = self._made[name] = (key, make())
        kept: T = found[1]
        return kept

    def _forget(self) -> None:
        self._made: dict[str, tuple[object, Any]] = {}


def fitted(size: tuple[int, ...], width_px: int) -> tuple[int, int]:
    """Return (height, width) after shrinking to at most `width_px`, aspect kept; 0: no limit.

    >>> fitted((1080, 1920), 480), fitted((270, 480), 640)
    ((270, 480), (270, 480))
    """
    height, width = size
    if not width_px or width <= width_px:
        return height, width
    return max(1, round(height * width_px / width)), width_px


def shrink(image: NDArray[np.uint8], out: NDArray[np.uint8]) -> None:
    """Shrink (h, w) or (h, w, 3) into `out` by averaging areas; the same size is copied."""
    cv2.resize(image, (out.shape[1], out.shape[0]), dst=out, interpolation=cv2.INTER_AREA)


def demosaic(mosaic: NDArray[np.uint8], order: str, out: NDArray[np.uint8]) -> None:
    """Interpolate a mosaic (h, w) of that order to RGB (h, w, 3), bilinear.

    Raises `MessageError` for one that is too small to have neighbours.
    """
    if min(mosaic.shape) < LEAST_MOSAIC_PX:
        height, width = mosaic.shape
        least = f"{LEAST_MOSAIC_PX}x{LEAST_MOSAIC_PX}"
        raise MessageError(f"frame: expected a mosaic of at least {least}, got {width}x{height}")
    cv2.cvtColor(mosaic, getattr(cv2, f"COLOR_Bayer{order.upper()}2RGB"), out)
