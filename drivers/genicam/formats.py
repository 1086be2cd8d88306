"""Pixel formats by the Pixel Format Naming Convention (PFNC): bytes in, a picture out.

The `p` formats travel as they are. GigE Vision's older `…Packed` ones, which cameras of both
interfaces still have, are unpacked: two samples lie in three bytes, and the byte in the middle has
the low bits of both (for 12 bit: Basler racer GigE, user's manual, section 9.2.3).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.genicam.nodes import NodeMap
from drivers.genicam.stream import Arrived
from drivers.samples import STRIP, Samples
from pipeline.forecast import PictureStream
from pipeline.pixel_formats import BY_PFNC, FORMATS, PixelFormat

BYTES_OF_PAIR = 3  # of GigE Vision's older formats


@dataclass(frozen=True, kw_only=True)
class CameraFormat:
    """One format that a picture can be made from."""

    name: str  # PFNC
    code: int  # PFNC, 32 bit
    form: PixelFormat  # of the frames
    paired: bool = False  # the older packing: unpacked into `form`

    @property
    def ours(self) -> str:
        """The format of frames, by its name."""
        return self.form.name

    @property
    def unpacked(self) -> PixelFormat:
        """The format of the same samples, each in a number of its own."""
        return FORMATS[self.form.name.rstrip("p")] if self.form.packed else self.form

    @property
    def packs(self) -> bool:
        """Whether samples share bytes."""
        return self.paired or self.form.packed

    @property
    def multiple_px(self) -> int:
        """Widths whose rows are whole bytes: the formats do not pad rows."""
        if self.paired:
            return 2
        return {10: 4, 12: 2}[self.form.bits] if self.form.packed else 1

    def row_bytes(self, width_px: int) -> int:
        """Bytes of one row as the camera sends it."""
        return width_px // 2 * BYTES_OF_PAIR if self.paired else self.form.row_bytes(width_px)

    def crossing(self, size_px: tuple[int, int], rate_hz: float) -> PictureStream:
        """What the link carries: pictures as the camera sends them."""
        width, height = size_px
        return PictureStream(
            size_px=size_px,
            pixel_format=self.name,
            frame_bytes=self.row_bytes(width) * height,
            rate_hz=rate_hz,
        )


def _formats() -> tuple[CameraFormat, ...]:
    """All formats, the best first: colours, then mosaics of 8 bit, then deeper ones."""
    mosaics = [f"Bayer{order}" for order in ("RG", "GR", "GB", "BG")]
    names = ["RGB8", "BGR8"]
    for depth in ("8", "16", "12p", "12", "12Packed", "10p", "10", "10Packed", "14"):
        names += [f"{kind}{depth}" for kind in (*mosaics, "Mono")]
    return tuple(_format(name) for name in names)


def _format(name: str) -> CameraFormat:
    if name not in _PAIRED:
        return CameraFormat(name=name, code=BY_PFNC[name].code, form=BY_PFNC[name])
    form = BY_PFNC[name.removesuffix("Packed")]
    return CameraFormat(name=name, code=_PAIRED[name], form=form, paired=True)


_PAIRED = {
    "Mono10Packed": 0x010C0004, "BayerGR10Packed": 0x010C0026, "BayerRG10Packed": 0x010C0027,
    "BayerGB10Packed": 0x010C0028, "BayerBG10Packed": 0x010C0029, "Mono12Packed": 0x010C0006,
    "BayerGR12Packed": 0x010C002A, "BayerRG12Packed": 0x010C002B, "BayerGB12Packed": 0x010C002C,
    "BayerBG12Packed": 0x010C002D,
}  # fmt: skip
CAMERA_FORMATS = _formats()
BY_CODE: Mapping[int, CameraFormat] = {form.code: form for form in CAMERA_FORMATS}
BY_NAME: Mapping[str, CameraFormat] = {form.name: form for form in CAMERA_FORMATS}


def offered(found: NodeMap) -> tuple[str, ...]:
    """PFNC names of the formats that a camera states and that can be read, the best first.

    Cameras name them differently (RGB8Packed is RGB8): the code decides.
    """
    node = found.get("PixelFormat")
    codes = {code & 0xFFFFFFFF for code in node.entries.values()} if node else set()
    return tuple(form.name for form in CAMERA_FORMATS if form.code in codes)


def entry_of(found: NodeMap, name: str) -> str:
    """What the camera itself calls a PFNC format; empty: it has none of this code."""
    node, form = found.get("PixelFormat"), BY_NAME.get(name)
    if node is None or form is None:
        return ""
    return next((n for n, code in node.entries.items() if code & 0xFFFFFFFF == form.code), "")


def picture(
    memory: NDArray[np.uint8], *, width_px: int, height_px: int, padding: int, form: CameraFormat
) -> NDArray[np.uint8] | NDArray[np.uint16] | None:
    """A view of a frame's bytes: (h, w), (h, w, 3), or (h, row_bytes) of packed ones.

    None where bytes are missing, and for a width whose packed rows are no whole bytes.
    """
    if min(width_px, height_px) < 1 or padding < 0 or width_px % form.multiple_px:
        return None
    row_bytes = form.row_bytes(width_px)
    stride = row_bytes + padding
    if memory.size < stride * (height_px - 1) + row_bytes:
        return None
    if form.paired:
        return np.ndarray((height_px, row_bytes), np.uint8, memory, strides=(stride, 1))
    shape, depth = form.form.shape((width_px, height_px)), np.dtype(form.form.dtype)
    inner = (depth.itemsize * form.form.channels, depth.itemsize)[: len(shape) - 1]
    return np.ndarray(shape, depth.newbyteorder("<"), memory, strides=(stride, *inner))


def view(arrived: Arrived, form: CameraFormat) -> NDArray[np.uint8] | NDArray[np.uint16] | None:
    """The picture within a buffer, not copied; None where bytes are missing."""
    return picture(
        arrived.memory,
        width_px=arrived.width_px,
        height_px=arrived.height_px,
        padding=arrived.padding,
        form=form,
    )


def copy_frame(pixels: NDArray[Any], form: CameraFormat, out: NDArray[Any]) -> None:
    """Copy a picture that `picture` returned into memory of `form.form`."""
    if form.paired:
        unpack_pairs(pixels, form.form.bits, out)
    else:
        np.copyto(out, pixels)


def unpack(pixels: NDArray[Any], form: CameraFormat, out: NDArray[np.uint16]) -> None:
    """Write the samples of a packed picture into `out` (h, w)."""
    if form.paired:
        unpack_pairs(pixels, form.form.bits, out)
        return
    samples = Samples(form.form, out.shape[1])
    for top in range(0, len(out), STRIP):
        out[top : top + STRIP] = samples(pixels[top : top + STRIP])


def unpack_pairs(rows: NDArray[np.uint8], bits: int, out: NDArray[np.uint16]) -> None:
    """Write samples (h, w) from rows (h, 3 w / 2) of GigE Vision's older packing, 10 or 12 bit.

    The first and third byte have the high 8 bits of the two samples. The second one has the low
    bits of the first sample from bit 0 on and those of the second from bit 4 on.

    >>> out = np.zeros((1, 2), np.uint16)
    >>> unpack_pairs(np.array([[0xAB, 0x1C, 0xDE]], np.uint8), 12, out)
    >>> [hex(sample) for sample in out[0]]
    ['0xabc', '0xde1']
    """
    low, mask = bits - 8, (1 << bits - 8) - 1
    middle = rows[:, 1::BYTES_OF_PAIR]
    for first, shift in ((0, 0), (1, 4)):
        samples = out[:, first::2]
        np.copyto(samples, rows[:, 2 * first :: BYTES_OF_PAIR])
        np.left_shift(samples, low, out=samples)
        np.bitwise_or(samples, middle >> shift & mask, out=samples)
