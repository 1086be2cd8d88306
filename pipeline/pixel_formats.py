"""The pixel formats of frames: names, bits, packing, colour order and bytes per row, in one table.

Raw pictures travel as the device sent them. A packed picture is (h, row_bytes) uint8, in which
`row_bytes` is not its width; `Frame.size_px` tells the size of any picture. A Bayer format is named
by the order of the picture's own first pixel, so a cut that starts at an odd pixel has another
format: `PixelFormat.shifted`.

Names map to those of the GenICam Pixel Format Naming Convention (PFNC 2.x), with their codes.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from pipeline.errors import MessageError

ORDERS = {"rggb": "RG", "grbg": "GR", "gbrg": "GB", "bggr": "BG"}  # ours -> PFNC's first two pixels


@dataclass(frozen=True, kw_only=True)
class PixelFormat:
    """One format of the table.

    Packed samples are a stream of bits, least significant first (PFNC's `p`); each row begins at a
    byte. Samples of more than 8 bits that are not packed lie in the low bits of uint16.
    """

    name: str
    pfnc: str
    code: int  # of PFNC, as in the leader of a USB3 Vision or GigE Vision frame
    bits: int  # of one sample
    order: str = ""  # rggb | grbg | gbrg | bggr from the first pixel on; empty: no mosaic
    packed: bool = False
    channels: int = 1

    @property
    def white(self) -> int:
        """The largest value of a sample."""
        return (1 << self.bits) - 1

    @property
    def dtype(self) -> DTypeLike:
        """Of `Frame.pixels`."""
        return np.uint8 if self.packed or self.bits == 8 else np.uint16

    def row_bytes(self, width_px: int) -> int:
        """Bytes of one row.

        >>> FORMATS["bayer_rggb10p"].row_bytes(4), FORMATS["bayer_rggb12p"].row_bytes(3)
        (5, 5)
        """
        samples = width_px * self.channels
        if self.packed:
            return -(-samples * self.bits // 8)
        return samples * np.dtype(self.dtype).itemsize

    def shape(self, size_px: tuple[int, int]) -> tuple[int, ...]:
        """Shape of `Frame.pixels` for a picture of this width and height."""
        width, height = size_px
        if self.packed:
            return (height, self.row_bytes(width))
        return (height, width) if self.channels == 1 else (height, width, self.channels)

    def size_px(self, shape: tuple[int, ...]) -> tuple[int, int]:
        """Width and height of a picture whose pixels have that shape.

        >>> FORMATS["bayer_rggb12p"].size_px((1148, 3060)), FORMATS["rgb8"].size_px((27, 48, 3))
        ((2040, 1148), (48, 27))
        """
        # at most 7 bits of padding end a row, fewer than a sample has
        return (shape[1] * 8 // self.bits if self.packed else shape[1]), shape[0]

    def shifted(self, right_px: int, down_px: int) -> "PixelFormat":
        """Return the format of the cut that begins so many pixels to the right and below.

        >>> FORMATS["bayer_rggb8"].shifted(3, 0).name, FORMATS["grey8"].shifted(1, 1).name
        ('bayer_grbg8', 'grey8')
        """
        if not self.order:
            return self
        cell = (self.order[:2], self.order[2:])
        rows = cell[down_px % 2], cell[1 - down_px % 2]
        order = "".join(row[right_px % 2] + row[1 - right_px % 2] for row in rows)
        return FORMATS[self.name.replace(self.order, order)]

    def check(self, where: str, pixels: NDArray[Any]) -> None:
        """Raise `MessageError` for pixels that cannot be of this format; empty ones can."""
        if not pixels.size:
            return
        sides = 2 if self.channels == 1 else 3
        if pixels.dtype != self.dtype or pixels.ndim != sides:
            form = {True: "(h, row_bytes)", False: "(h, w)"}[self.packed]
            wanted = f"{np.dtype(self.dtype)} {form if sides == 2 else '(h, w, 3)'}"
            raise MessageError(
                f"{where}: expected {wanted} as {self.name} has it, got {pixels.dtype} "
                f"{pixels.shape}"
            )


def _rows() -> list[PixelFormat]:
    """The whole table; the codes are those of PFNC's list of values."""
    found = [
        PixelFormat(name="rgb8", pfnc="RGB8", code=0x02180014, bits=8, channels=3),
        PixelFormat(name="bgr8", pfnc="BGR8", code=0x02180015, bits=8, channels=3),
    ]
    grey = {
        "8": 0x01080001, "10": 0x01100003, "10p": 0x010A0046, "12": 0x01100005,
        "12p": 0x010C0047, "14": 0x01100025, "16": 0x01100007,
    }  # fmt: skip
    bayer = {  # of GR, RG, GB, BG
        "8": (0x01080008, 0x01080009, 0x0108000A, 0x0108000B),
        "10": (0x0110000C, 0x0110000D, 0x0110000E, 0x0110000F),
        "10p": (0x010A0056, 0x010A0058, 0x010A0054, 0x010A0052),
        "12": (0x01100010, 0x01100011, 0x01100012, 0x01100013),
        "12p": (0x010C0057, 0x010C0059, 0x010C0055, 0x010C0053),
        "14": (0x01100109, 0x0110010A, 0x0110010B, 0x0110010C),
        "16": (0x0110002E, 0x0110002F, 0x01100030, 0x01100031),
    }
    for depth, code in grey.items():
        found.append(_sampled(f"grey{depth}", f"Mono{depth}", code, depth, ""))
    for depth, codes in bayer.items():
        for order, code in zip(("grbg", "rggb", "gbrg", "bggr"), codes, strict=True):
            name, pfnc = f"bayer_{order}{depth}", f"Bayer{ORDERS[order]}{depth}"
            found.append(_sampled(name, pfnc, code, depth, order))
    return found


def _sampled(name: str, pfnc: str, code: int, depth: str, order: str) -> PixelFormat:
    bits, packed = int(depth.rstrip("p")), depth.endswith("p")
    return PixelFormat(name=name, pfnc=pfnc, code=code, bits=bits, order=order, packed=packed)


FORMATS: Mapping[str, PixelFormat] = MappingProxyType({f.name: f for f in _rows()})
BY_PFNC: Mapping[str, PixelFormat] = MappingProxyType({f.pfnc: f for f in FORMATS.values()})
BY_CODE: Mapping[int, PixelFormat] = MappingProxyType({f.code: f for f in FORMATS.values()})
PACKED = frozenset(f.name for f in FORMATS.values() if f.packed)


def pixel_format(name: str, where: str) -> PixelFormat:
    """Return the format that a frame names; raises `MessageError` for one that is not known.

    >>> pixel_format("BayerRG12p", "frame")
    Traceback (most recent call last):
    pipeline.errors.MessageError: frame: expected pixels as rgb8, grey8, bayer_rggb8 or another \
name of pipeline.pixel_formats, got BayerRG12p, here called bayer_rggb12p
    """
    if name in FORMATS:
        return FORMATS[name]
    hint = f", here called {BY_PFNC[name].name}" if name in BY_PFNC else ""
    raise MessageError(
        f"{where}: expected pixels as rgb8, grey8, bayer_rggb8 or another name of "
        f"pipeline.pixel_formats, got {name[:60]}{hint}"
    )


def size_px(name: str, shape: tuple[int, ...]) -> tuple[int, int]:
    """Return width and height of a picture; a format that is not in the table is not packed."""
    found = FORMATS.get(name)
    return found.size_px(shape) if found is not None else (shape[1], shape[0])
