"""Automatic white balance: a raw picture in, the gains under which it is grey on average out.

The grey-world assumption (Buchsbaum, 1980): the mean reflectance of a scene has no colour. It holds
for a field of view, hardly for a part of it: an ROI takes its gains from the context.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.samples import Samples
from operators.downsample.tone import Gains
from pipeline.pixel_formats import PixelFormat

ROWS = 48  # pairs of rows that are looked at, spread over the picture
SATURATED = 0.98  # share of white; a saturated sample says nothing of the colour
LEAST = 64  # superpixels that must remain, else the gains stay as they are
STRONGEST = 8.0  # no gain is above it, nor below its inverse


@dataclass(frozen=True, kw_only=True)
class Balance:
    """What is known of the light; it survives a swap."""

    gains: Gains = (1.0, 1.0, 1.0)
    frames: int = 0  # it was measured on; 0: never

    def towards(self, seen: Gains, share: float) -> "Balance":
        """Return the balance after one more frame, whose gains count with `share`."""
        part = share if self.frames else 1.0
        mixed = tuple(
            old ** (1 - part) * new**part for old, new in zip(self.gains, seen, strict=True)
        )
        return Balance(gains=(mixed[0], mixed[1], mixed[2]), frames=self.frames + 1)


def grey_world(
    pixels: NDArray[Any], form: PixelFormat, width_px: int, *, black: int, white: int
) -> Gains | None:
    """Gains of red, green (1) and blue of a mosaic; None where too little is neither dark nor full.

    Looks at `ROWS` pairs of rows.
    """
    pairs = len(pixels) // 2
    read = Samples(form, width_px)
    step = max(1, pairs // ROWS)
    even = width_px - width_px % 2
    cells = [
        np.array(read(pixels[2 * row : 2 * row + 2])[:, :even], np.float32)
        for row in range(step // 2, pairs, step)
    ]
    if not cells:
        return None
    rows = np.stack(cells).reshape(len(cells), 2, even // 2, 2)
    sites = rows.transpose(0, 2, 1, 3).reshape(-1, 4) - black
    kept = sites[(sites.max(1) < SATURATED * (white - black)) & (sites.mean(1) > 0)]
    if len(kept) < LEAST:
        return None
    means = kept.mean(0)
    colour = {c: float(means[[site == c for site in form.order]].mean()) for c in "rgb"}
    if min(colour.values()) <= 0:
        return None
    red, blue = (float(np.clip(colour["g"] / colour[c], 1 / STRONGEST, STRONGEST)) for c in "rb")
    return red, 1.0, blue
