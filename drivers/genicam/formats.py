"""Pixel formats by the Pixel Format Naming Convention (PFNC): bytes in, a picture out."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.genicam.nodes import NodeMap
from drivers.genicam.stream import Arrived


@dataclass(frozen=True, kw_only=True)
class PixelFormat:
    """One format that a picture can be made from without arithmetic."""

    name: str  # PFNC
    code: int  # PFNC, 32 bit
    ours: str  # as frames name it
    channels: int = 1
    wide: bool = False  # 16 bit, little-endian

    @property
    def pixel_bytes(self) -> int:
        """Bytes of one pixel."""
        return self.channels * (2 if self.wide else 1)


FORMATS: tuple[PixelFormat, ...] = (
    PixelFormat(name="RGB8", code=0x02180014, ours="rgb8", channels=3),
    PixelFormat(name="BGR8", code=0x02180015, ours="bgr8", channels=3),
    PixelFormat(name="BayerRG8", code=0x01080009, ours="bayer_rggb8"),
    PixelFormat(name="BayerGR8", code=0x01080008, ours="bayer_grbg8"),
    PixelFormat(name="BayerGB8", code=0x0108000A, ours="bayer_gbrg8"),
    PixelFormat(name="BayerBG8", code=0x0108000B, ours="bayer_bggr8"),
    PixelFormat(name="Mono8", code=0x01080001, ours="grey8"),
    PixelFormat(name="BayerRG16", code=0x0110002F, ours="bayer_rggb16", wide=True),
    PixelFormat(name="BayerGR16", code=0x0110002E, ours="bayer_grbg16", wide=True),
    PixelFormat(name="BayerGB16", code=0x01100030, ours="bayer_gbrg16", wide=True),
    PixelFormat(name="BayerBG16", code=0x01100031, ours="bayer_bggr16", wide=True),
    PixelFormat(name="Mono16", code=0x01100007, ours="grey16", wide=True),
)
BY_CODE: Mapping[int, PixelFormat] = {form.code: form for form in FORMATS}
BY_NAME: Mapping[str, PixelFormat] = {form.name: form for form in FORMATS}


def offered(found: NodeMap) -> tuple[str, ...]:
    """PFNC names of the formats that a camera states and that can be read, the best first.

    Cameras name them differently (RGB8Packed is RGB8): the code decides.
    """
    node = found.get("PixelFormat")
    codes = {code & 0xFFFFFFFF for code in node.entries.values()} if node else set()
    return tuple(form.name for form in FORMATS if form.code in codes)


def entry_of(found: NodeMap, name: str) -> str:
    """What the camera itself calls a PFNC format; empty: it has none of this code."""
    node, form = found.get("PixelFormat"), BY_NAME.get(name)
    if node is None or form is None:
        return ""
    return next((n for n, code in node.entries.items() if code & 0xFFFFFFFF == form.code), "")


def picture(
    memory: NDArray[np.uint8], *, width_px: int, height_px: int, padding: int, form: PixelFormat
) -> NDArray[np.uint8] | NDArray[np.uint16] | None:
    """A view of a frame's bytes: (h, w) or (h, w, 3); None where bytes are missing."""
    pixel, stride = form.pixel_bytes, width_px * form.pixel_bytes + padding
    if min(width_px, height_px) < 1 or padding < 0:
        return None
    if memory.size < stride * (height_px - 1) + width_px * pixel:
        return None
    depth = np.dtype("<u2") if form.wide else np.dtype(np.uint8)
    shape: tuple[int, ...] = (height_px, width_px)
    strides: tuple[int, ...] = (stride, pixel)
    if form.channels > 1:
        shape, strides = (*shape, form.channels), (*strides, depth.itemsize)
    return np.ndarray(shape, depth, buffer=memory, strides=strides)


def view(arrived: Arrived, form: PixelFormat) -> NDArray[np.uint8] | NDArray[np.uint16] | None:
    """The picture within a buffer, not copied; None where bytes are missing."""
    return picture(
        arrived.memory,
        width_px=arrived.width_px,
        height_px=arrived.height_px,
        padding=arrived.padding,
        form=form,
    )
