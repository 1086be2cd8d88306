"""What is written on shirts: actors in the order of drawing -> truth of numbers and names."""

import numpy as np
from numpy.typing import NDArray

from drivers.scenes.soccer.stage import Actor
from drivers.source import Annotations

ILLEGIBLE = "###"  # the label of a text that is not to be scored in this frame
LEAST_LEGIBLE_PX = 9.0  # height of a text that a reader can read
LEAST_SEEN = 0.85  # share of a text that must be visible
LEAST_CLEAR = 0.8  # share of the shirt around it whose brightness must differ from the ink's
NAME_IDS = 100  # of a name: the id of the person, and this


def shirts_of(actors: list[Actor], size_px: tuple[int, int]) -> Annotations:
    """Return boxes, texts and visible shares of what backs show.

    The id of a number is that of the person who wears it: once read, it is known as long as the
    person is followed. Of a number and a name that are too small, mostly hidden, or on stripes as
    bright as they are, the label is `ILLEGIBLE`.
    """
    rows = []
    for i, actor in enumerate(actors):
        for print_ in actor.prints:
            seen = print_.seen * _seen(print_.box, actors[i + 1 :], size_px)
            tall = print_.box[3] - print_.box[1]
            legible = (
                seen >= LEAST_SEEN and tall >= LEAST_LEGIBLE_PX and print_.clear >= LEAST_CLEAR
            )
            number = print_.text.isdigit()
            rows.append(
                (
                    actor.id if number else actor.id + NAME_IDS,
                    np.clip(print_.box, 0, [*size_px, *size_px]),
                    print_.text if legible else ILLEGIBLE,
                    seen,
                )
            )
    rows = sorted((row for row in rows if row[3] > 0), key=lambda row: row[0])
    return Annotations(
        boxes=np.array([row[1] for row in rows], np.float32).reshape(-1, 4),
        ids=np.array([row[0] for row in rows], np.int32),
        labels=tuple(row[2] for row in rows),
        visibility=np.array([row[3] for row in rows], np.float32),
    )


def _seen(
    box: tuple[float, float, float, float], nearer: list[Actor], size_px: tuple[int, int]
) -> float:
    """Return the share of a box that is in the picture and that no nearer actor hides."""
    whole = np.array(box).round().astype(int)
    x0, y0, x1, y1 = np.clip(whole, 0, [*size_px, *size_px]).tolist()
    free: NDArray[np.bool_] = np.ones((max(y1 - y0, 0), max(x1 - x0, 0)), bool)
    for other in nearer:
        h, w = other.patch.shape[:2]
        left, top = max(x0, other.left), max(y0, other.top)
        right, low = min(x1, other.left + w), min(y1, other.top + h)
        if left < right and top < low:
            alpha = other.patch[
                top - other.top : low - other.top, left - other.left : right - other.left, 3
            ]
            free[top - y0 : low - y0, left - x0 : right - x0] &= alpha < other.solid
    area = max(1, int((whole[2] - whole[0]) * (whole[3] - whole[1])))
    return float(free.sum()) / area
