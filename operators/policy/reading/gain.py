"""What looks at texts promise, by a rule: what was shown and read -> gains, 0..1.

A text promises the more, the larger it is than it was when it was last shown, and the longer ago
that was. What was read promises little: a reader is sure of wrong readings, too.
"""

import numpy as np
from numpy.typing import NDArray

from operators.policy.looks import Looks
from operators.policy.readability import chances, heights
from operators.policy.reading.windows import WHOLE
from pipeline import Geometry
from pipeline.boxes import Array, covered

MOST_AGE = 32  # frames: an older look makes no difference
RETRY = 0.5  # gain of a second look after MOST_AGE frames, of that of the first
VERIFY = 0.2  # gain of a text that was read, of that of one that was not
SEARCH = 0.005  # gain of searching the field


def gains(chance: Array, tried: Array, age: NDArray[np.int64], retry: float) -> Array:
    """Return what a look at each text (n,) promises while it is unread, 0..1.

    `chance` is that of reading it now, `tried` the highest at which it was shown, 0: never shown,
    and `age` the frames since its last look.
    """
    again = np.where(tried > 0, retry * np.clip(age / MOST_AGE, 0, 1), 0)
    return np.asarray(np.maximum(chance - tried, 0) + again * chance, np.float32)


def foreseen(predicted: Array, geometry: Geometry) -> Array:
    """Return the chance to read each text at each step: (n, Tp, 4) -> (n, Tp); 0 out of view."""
    field = np.array([0, 0, geometry.width_px, geometry.height_px], np.float32)
    inside = covered(predicted.reshape(-1, 4), field).reshape(predicted.shape[:2]) >= WHOLE
    return np.asarray(chances(heights(predicted)) * inside, np.float32)


def promised(
    looks: Looks,
    rows: NDArray[np.intp],
    chance: Array,
    shows: NDArray[np.bool_],
    *,
    first_seq: int,
    sure: float,
    delay: int,
) -> Array:
    """Return the gain of a window for each text at each step of the greedy plan: (n, Tp).

    `chance` is (n, Tp), and `shows` (n, n) tells which texts each window shows. The greedy plan
    takes the best window at each step from `delay` on.
    """
    unread = np.where(looks.read[rows] < sure, np.float32(1), np.float32(VERIFY))
    tried, shown_seq = looks.tried[rows].copy(), looks.shown_seq[rows].copy()
    found = np.zeros(chance.shape, np.float32)
    for step in range(chance.shape[1] if len(rows) else 0):
        age = first_seq + step - shown_seq
        found[:, step] = shows @ (unread * gains(chance[:, step], tried, age, RETRY))
        if step >= delay:
            inside = shows[int(found[:, step].argmax())]
            tried[inside] = np.maximum(tried, chance[:, step])[inside]
            shown_seq[inside] = first_seq + step
    return found
