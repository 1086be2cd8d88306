"""Draw the ball: its path during the exposure -> a premultiplied RGBA patch."""

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.scenes.soccer.looks import Colour

Image = NDArray[np.uint8]

DISC_PX = 96  # side of the disc's own picture
ROLLS = 12


def discs(rng: np.random.Generator, light: float) -> list[Image]:
    """Draw a ball from `ROLLS` sides: white or tinted, with dark or coloured panels, shaded."""
    grounds: tuple[Colour, ...] = (
        (250, 250, 250),
        (250, 250, 250),
        (245, 240, 225),
        (235, 250, 90),
    )
    inks: tuple[Colour, ...] = ((30, 30, 35), (60, 90, 170), (220, 60, 50), (150, 150, 155))
    ground = np.array(grounds[int(rng.choice(4, p=[0.45, 0.35, 0.15, 0.05]))], float)
    ink = np.array(inks[int(rng.integers(len(inks)))], float)
    bold = float(rng.uniform(0.06, 0.36))
    grid = (np.arange(DISC_PX) + 0.5) / DISC_PX * 2 - 1
    x, y = np.meshgrid(grid, grid)
    z = np.sqrt(np.clip(1 - x * x - y * y, 0, 1))
    inside = np.clip((1 - np.hypot(x, y)) * DISC_PX / 2, 0, 1)
    shade = np.clip(0.72 + 0.34 * (-0.25 * x - 0.75 * y + 0.6 * z), 0.45, 1.08) * light
    spots = rng.normal(0, 1, (9, 3))
    spots /= np.linalg.norm(spots, axis=1, keepdims=True)
    made = []
    for roll in range(ROLLS):
        a = 2 * np.pi * roll / ROLLS
        turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
        seen = np.stack([x, y, z], -1) @ (turn @ spots.T)
        panel = np.clip((seen.max(-1) - (1 - bold * 0.28)) * 30, 0, 1)[..., None]
        colour = (ground * (1 - panel) + ink * panel) * shade[..., None]
        flat = np.dstack([np.clip(colour, 0, 255), np.full_like(x, 255)]) * inside[..., None]
        made.append(flat.astype(np.uint8))
    return made


def streak(
    disc: Image, diameter_px: float, start: tuple[float, float], end: tuple[float, float]
) -> tuple[Image, int, int]:
    """Sweep the disc from start to end (picture pixels); return patch, left, top."""
    reach = diameter_px / 2 + 2
    left, top = int(min(start[0], end[0]) - reach), int(min(start[1], end[1]) - reach)
    right, bottom = int(max(start[0], end[0]) + reach) + 2, int(max(start[1], end[1]) + reach) + 2
    length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
    count = min(2 + int(length / 1.5), 24)
    scale = diameter_px / DISC_PX
    total = np.zeros((bottom - top, right - left, 4), np.float32)
    k = max(1, int(0.7 / scale)) | 1
    soft = cv2.blur(disc, (k, k))  # else shrinking by so much would alias
    for share in (np.arange(count) + 0.5) / count:
        x = start[0] + share * (end[0] - start[0]) - left - diameter_px / 2 + 0.5 * scale - 0.5
        y = start[1] + share * (end[1] - start[1]) - top - diameter_px / 2 + 0.5 * scale - 0.5
        m = np.array([[scale, 0, x], [0, scale, y]], np.float32)
        cv2.accumulate(cv2.warpAffine(soft, m, total.shape[1::-1]), total)
    return (total / count).astype(np.uint8), left, top
