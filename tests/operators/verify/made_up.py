"""Made-up detections, tracks and ROIs for the tests of the second look."""

import numpy as np

from pipeline import Detections, Frame
from pipeline.testing import header

NAMES = ("ball", "player")
WINDOW = (480, 270, 960, 540)


def detections(*objects: tuple[str, float, float, float, float], channels: int = 2) -> Detections:
    """Return objects (class, score, centre x, centre y, height); as wide as high."""
    rows = np.array([o[1:] for o in objects], np.float32).reshape(-1, 4)
    half = rows[:, 3:] / 2
    return Detections(
        header=header(0),
        boxes=np.hstack([rows[:, 1:3] - half, rows[:, 1:3] + half]),
        angles=np.zeros(len(rows), np.float32),
        scores=rows[:, 0],
        labels=np.array([NAMES.index(o[0]) for o in objects], np.int32),
        features=np.ones((len(rows), channels), np.float32),
        names=NAMES,
    )


def roi(window: tuple[int, int, int, int] = WINDOW) -> Frame:
    """Return the ROI of this window."""
    left, top, right, bottom = window
    return Frame(
        header=header(0), pixels=np.zeros((bottom - top, right - left, 3), np.uint8),
        window=window, pixel_format="rgb8",
    )  # fmt: skip
