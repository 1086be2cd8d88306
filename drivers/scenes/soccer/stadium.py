"""Draw the background of the pitch: a seed -> a flat wall of billboards and crowd."""

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

WALL_PX_PER_M = 24
WALL_M = (270.0, 15.0)  # all around three sides; height
BOARD_M = 1.0
WORDS = (
    *("SPORT", "fovea", "ENERGY", "Bank 24", "TELECOM", "AIRLINES", "Cola", "MOTORS", "tv1"),
    *("INSURANCE", "radio", "www", "LIGA", "MARKT", "solar", "HOTEL", "Kaffee", "BET"),
)


def wall(rng: np.random.Generator, light: float) -> Image:
    """Draw the wall from the ground (lowest row) up: RGB, `WALL_PX_PER_M`."""
    width, height = (round(side * WALL_PX_PER_M) for side in WALL_M)
    image = np.empty((height, width, 3), np.uint8)
    boards = round(BOARD_M * WALL_PX_PER_M)
    block = crowd(rng, width // 3 + 1, height - boards)
    image[:-boards] = np.concatenate([block, block[:, ::-1], block], 1)[:, :width]
    hang_banners(image[:-boards], rng)
    image[-boards:] = billboards(rng, width, boards)
    gain = light * rng.uniform(0.75, 1.0)
    return np.asarray(cv2.convertScaleAbs(image, alpha=gain))


def crowd(rng: np.random.Generator, width: int, height: int) -> Image:
    """Draw rows of seats, some of them taken, mostly by people in dark clothes."""
    seat = rng.integers(30, 200, 3)
    image = np.empty((height, width, 3), np.uint8)
    image[:] = seat * 0.55
    close = rng.uniform(0.65, 1.0)  # rows seen from low down stand close together
    row, place = round(0.8 * close * WALL_PX_PER_M), round(0.5 * WALL_PX_PER_M)
    full, dark = rng.uniform(0.1, 0.98), rng.uniform(0.25, 0.8)
    for y in range(row, height + row, row):
        cv2.rectangle(image, (0, y - row // 3), (width, y), (seat * 0.35).tolist(), -1)
        for x in range(0, width, place):
            jitter = rng.integers(-3, 4, 4)
            if rng.random() > full:
                corner = (x + place - 4, y - row // 3)
                cv2.rectangle(image, (x + 2, y - row // 2), corner, seat.tolist(), -1)
                continue
            _spectator(image, rng, (x + int(jitter[0]), y + int(jitter[1])), place, dark)
    return image


def _spectator(
    image: Image, rng: np.random.Generator, at: tuple[int, int], place: int, dark: float
) -> None:
    rest = (1 - dark) / 3
    grey = rng.choice([25, 60, 130, 235], p=[dark, rest, rest, rest])
    cloth = np.clip(grey + rng.normal(0, 28, 3), 5, 250).tolist()
    skin = (np.array([215, 165, 135]) * rng.uniform(0.4, 1.05)).tolist()
    x, y = at
    cv2.ellipse(image, (x, y), (place // 2, place // 2 + 4), 0, 180, 360, cloth, -1)
    cv2.circle(image, (x, y - place // 2 - 7), 4, skin, -1)


def hang_banners(stands: Image, rng: np.random.Generator) -> None:
    """Draw banners with words, flags, stairs and walls before the stands, in place."""
    height, width = stands.shape[:2]
    if rng.random() < 0.4:  # a bare wall under the first row
        rise = round(float(rng.uniform(0.6, 2.2)) * WALL_PX_PER_M)
        stands[-rise:] = rng.integers(30, 215, 3)
    for _ in range(rng.integers(0, 40)):
        wide, tall = rng.uniform(2, 16), rng.uniform(0.7, 2.4)
        ground = np.clip(rng.choice([15, 120, 240]) + rng.normal(0, 60, 3), 0, 255)
        corners = np.array([[0, 0], [wide, 0], [wide, -tall], [0, -tall]]) * WALL_PX_PER_M
        lean = rng.choice([0.0, 0.0, rng.uniform(-0.8, 0.8)])  # flags lean, banners hang
        turn = np.array([[np.cos(lean), -np.sin(lean)], [np.sin(lean), np.cos(lean)]])
        left, low = (
            float(rng.uniform(0, width)),
            height - float(rng.exponential(2.5)) * WALL_PX_PER_M,
        )
        cv2.fillPoly(stands, [(corners @ turn.T + (left, low)).astype(np.int32)], ground.tolist())
        if lean == 0:
            ink = (15, 15, 25) if ground.sum() > 380 else (250, 250, 250)
            size = tall * WALL_PX_PER_M / 32
            place = round(left) + 6, round(low - 0.2 * tall * WALL_PX_PER_M)
            cv2.putText(stands, str(rng.choice(WORDS)), place, 0, size, ink, 3, cv2.LINE_AA)


def billboards(rng: np.random.Generator, width: int, height: int) -> Image:
    """Draw boards side by side, each with a word, some of them white."""
    image = np.empty((height, width, 3), np.uint8)
    x = 0
    while x < width:
        wide = round(float(rng.uniform(5, 14)) * WALL_PX_PER_M)
        ground = np.clip(rng.choice([20, 60, 200, 245]) + rng.normal(0, 60, 3), 0, 255)
        ink = (255, 255, 255) if ground.sum() < 380 else (20, 20, int(rng.integers(20, 200)))
        image[:, x : x + wide] = ground
        word = str(rng.choice(WORDS))
        scale = height / 30 * rng.uniform(0.7, 1.0)
        for start in range(x + 8, x + wide - 60, max(120, wide // 2)):
            cv2.putText(image, word, (start, round(height * 0.78)), 0, scale, ink, 2, cv2.LINE_AA)
        x += wide
    for _ in range(40):  # emblems, which are round and white like the ball
        place = int(rng.integers(width)), int(rng.integers(4, height - 4))
        cv2.circle(image, place, int(rng.integers(2, 6)), (245, 245, 245), -1, cv2.LINE_AA)
    cv2.line(image, (0, 0), (width, 0), (210, 210, 210), 2)
    return image
