"""Draw what is behind the pitch: a seed -> a flat wall of billboards and crowd."""

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
    """The wall from the ground (lowest row) up: RGB, `WALL_PX_PER_M`."""
    width, height = (round(side * WALL_PX_PER_M) for side in WALL_M)
    image = np.empty((height, width, 3), np.uint8)
    boards = round(BOARD_M * WALL_PX_PER_M)
    block = crowd(rng, width // 3 + 1, height - boards)
    image[:-boards] = np.concatenate([block, block[:, ::-1], block], 1)[:, :width]
    image[-boards:] = billboards(rng, width, boards)
    gain = light * rng.uniform(0.75, 1.0)
    return np.asarray(cv2.convertScaleAbs(image, alpha=gain))


def crowd(rng: np.random.Generator, width: int, height: int) -> Image:
    """Rows of seats, some taken, most by people in dark clothes."""
    seat = rng.integers(30, 200, 3)
    image = np.empty((height, width, 3), np.uint8)
    image[:] = seat * 0.55
    row, place = round(0.8 * WALL_PX_PER_M), round(0.5 * WALL_PX_PER_M)
    full = rng.uniform(0.25, 0.98)
    for y in range(row, height + row, row):
        cv2.rectangle(image, (0, y - row // 3), (width, y), (seat * 0.35).tolist(), -1)
        for x in range(0, width, place):
            jitter = rng.integers(-3, 4, 4)
            if rng.random() > full:
                corner = (x + place - 4, y - row // 3)
                cv2.rectangle(image, (x + 2, y - row // 2), corner, seat.tolist(), -1)
                continue
            _spectator(image, rng, (x + int(jitter[0]), y + int(jitter[1])), place)
    return image


def _spectator(image: Image, rng: np.random.Generator, at: tuple[int, int], place: int) -> None:
    grey = rng.choice([25, 60, 130, 235], p=[0.45, 0.25, 0.15, 0.15])
    cloth = np.clip(grey + rng.normal(0, 28, 3), 5, 250).tolist()
    skin = (np.array([215, 165, 135]) * rng.uniform(0.4, 1.05)).tolist()
    x, y = at
    cv2.ellipse(image, (x, y), (place // 2, place // 2 + 4), 0, 180, 360, cloth, -1)
    cv2.circle(image, (x, y - place // 2 - 7), 4, skin, -1)


def billboards(rng: np.random.Generator, width: int, height: int) -> Image:
    """Boards side by side, each with a word, in colours of which some are white."""
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
    for _ in range(40):  # emblems: round and white, and no ball
        place = int(rng.integers(width)), int(rng.integers(4, height - 4))
        cv2.circle(image, place, int(rng.integers(2, 6)), (245, 245, 245), -1, cv2.LINE_AA)
    cv2.line(image, (0, 0), (width, 0), (210, 210, 210), 2)
    return image
