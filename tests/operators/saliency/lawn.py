"""A still made up for tests: people in a row and a ball on a lawn."""

import numpy as np

from operators.saliency.example import NAMES, Example

BALL, PLAYER, REFEREE = (NAMES.index(name) for name in ("ball", "player", "referee"))


def still(tall_px: float = 54.0, size: tuple[int, int] = (1920, 1080)) -> Example:
    """People in a row and a ball, on grass."""
    width, height = size
    picture = np.full((height, width, 3), (60, 130, 50), np.uint8)
    x = np.linspace(0.1, 0.9, 9)[:, None] * width
    people = np.hstack([x, x * 0 + height / 2, x + tall_px / 2, x * 0 + height / 2 + tall_px])
    boxes = np.vstack([people, [[width / 3, height / 3, width / 3 + 6, height / 3 + 6]]])
    return Example(
        picture=picture, boxes=boxes.astype(np.float32), labels=np.array([PLAYER] * 9 + [BALL]),
        ignored=np.zeros(10, np.bool_),
    )  # fmt: skip
