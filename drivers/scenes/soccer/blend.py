"""Lay small pictures over a large one in place: premultiplied RGBA on RGBA."""

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]


def over(picture: Image, patch: Image, left: int, top: int) -> None:
    """Draw a premultiplied RGBA patch onto an RGBA picture, clipped at its edges."""
    h, w = picture.shape[:2]
    x0, y0 = max(left, 0), max(top, 0)
    x1, y1 = min(left + patch.shape[1], w), min(top + patch.shape[0], h)
    if x0 >= x1 or y0 >= y1:
        return
    part = patch[y0 - top : y1 - top, x0 - left : x1 - left]
    place = picture[y0:y1, x0:x1]
    rest = cv2.bitwise_not(part[..., 3])
    cv2.multiply(place, cv2.merge([rest] * 4), dst=place, scale=1 / 255)
    cv2.add(place, part, dst=place)


def placed(
    sprite: Image, scale: float, anchor: tuple[float, float], at: tuple[float, float]
) -> tuple[Image, int, int]:
    """Scale a sprite, with its `anchor` (sprite pixels) on `at`; return patch, left, top.

    The place is exact to sub-pixels, so that slow objects do not jump from pixel to pixel.
    """
    left, top = at[0] - anchor[0] * scale, at[1] - anchor[1] * scale
    x0, y0 = int(np.floor(left)), int(np.floor(top))
    w = int(np.ceil(left + sprite.shape[1] * scale)) - x0 + 1
    h = int(np.ceil(top + sprite.shape[0] * scale)) - y0 + 1
    shift = (scale - 1) / 2  # pixel centres, not corners, are what is mapped
    m = np.array([[scale, 0, left - x0 + shift], [0, scale, top - y0 + shift]], np.float32)
    return cv2.warpAffine(sprite, m, (w, h), flags=cv2.INTER_LINEAR), x0, y0  # type: ignore[return-value]


def extent(alpha: Image, least: int = 100) -> tuple[int, int, int, int]:
    """Return the box xyxy around pixels that are at least that opaque; all 0 without any."""
    x, y, w, h = cv2.boundingRect((alpha >= least).view(np.uint8))
    return x, y, x + w, y + h


def smeared(patch: Image, left: int, top: int, way: tuple[float, float]) -> tuple[Image, int, int]:
    """Blur a patch along a movement of `way` pixels; return the larger patch, left, top."""
    kx, ky = odd(way[0]), odd(way[1])
    if kx == ky == 1:
        return patch, left, top
    px, py = kx // 2, ky // 2
    roomy = cv2.copyMakeBorder(patch, py, py, px, px, cv2.BORDER_CONSTANT, value=(0, 0, 0, 0))
    return np.asarray(cv2.blur(roomy, (kx, ky)), np.uint8), left - px, top - py


def odd(way_px: float) -> int:
    """Return the side of the blur's kernel for a movement; 1: none.

    >>> [odd(way) for way in (0.4, 1.9, -3.2, 500)]
    [1, 1, 3, 31]
    """
    return min(2 * int((abs(way_px) + 0.5) / 2) + 1, 31) if abs(way_px) >= 2 else 1
