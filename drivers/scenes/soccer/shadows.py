"""Darken the ground under and beside people and ball: actor -> premultiplied black patch."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

FALL = 0.16  # a shadow's reach down the picture, as a share of the height of what casts it
COARSE = 2  # pixels of the picture per pixel of a cast shadow, which is soft


@dataclass(frozen=True, kw_only=True)
class Light:
    """Depth and direction of shadows."""

    depth: float  # darkness of a shadow, 0..1
    sun: bool
    slant: float  # a shadow's reach to the right, as a share of the height; negative: to the left
    toward: float  # -1 it falls away from the camera, 1 towards it


def draw_light(rng: np.random.Generator) -> Light:
    """Draw the light: an overcast sky or flood light more often than sun."""
    sun = bool(rng.random() < 0.4)
    return Light(
        depth=float(rng.uniform(0.3, 0.6) if sun else rng.uniform(0.1, 0.35)),
        sun=sun,
        slant=float(rng.uniform(-1.3, 1.3)),
        toward=float(rng.choice([-1.0, 1.0])),
    )


@lru_cache(maxsize=256)
def contact(wide_px: int, high_px: int, depth: float) -> Image:
    """Return a soft dark ellipse of these half axes, in the middle of the patch."""
    patch = np.zeros((4 * high_px + 1, 4 * wide_px + 1, 4), np.uint8)
    axes = wide_px, high_px
    cv2.ellipse(patch, (2 * wide_px, 2 * high_px), axes, 0, 0, 360, (0, 0, 0, 255 * depth), -1)
    return np.asarray(cv2.blur(patch, (wide_px | 1, high_px | 1)), np.uint8)


def cast(
    patch: Image, feet: tuple[float, float], light: Light, lift_px: float
) -> tuple[Image, int, int]:
    """Return the shadow of a figure: patch, left, top relative to the figure's own patch.

    `feet` is the ground point in the figure's patch; it hangs `lift_px` above the ground.
    """
    h, w = patch.shape[:2]
    # shrink first: the shadow is so flat that a warp alone would skip most rows of the figure
    flat = max(2, round(h * FALL)), max(2, w // COARSE)
    alpha = cv2.resize(patch[..., 3], flat[::-1], interpolation=cv2.INTER_AREA)
    row, column = h / flat[0], w / flat[1]  # picture pixels in one of its rows and columns
    fall, base = FALL * light.toward, feet[1] + lift_px
    # a pixel that is n above the ground falls slant * n aside and fall * n down the picture
    ends = [light.slant * (base - y) for y in (0, h)]
    left, right = min(ends), w + max(ends)
    drops = [fall * (base - y) for y in (0, h)]
    size = int(right - left) // COARSE + 2, int(max(drops) - min(drops)) + 2
    m = np.array(
        [
            [column / COARSE, -light.slant * row / COARSE, (light.slant * base - left) / COARSE],
            [0, -fall * row, fall * base - min(drops)],
        ]
    )
    dark = cv2.warpAffine(alpha, m, size, flags=cv2.INTER_LINEAR)
    dark = cv2.resize(dark, (size[0] * COARSE, size[1]), interpolation=cv2.INTER_LINEAR)
    shadow = np.zeros((*dark.shape, 4), np.uint8)
    cv2.mixChannels([cv2.convertScaleAbs(dark, alpha=light.depth)], [shadow], [0, 3])
    return shadow, int(np.floor(left)), int(np.floor(feet[1] + min(drops)))
