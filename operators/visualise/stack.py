"""The loop's latency by stage as a stack: one column per frame, one colour per stage.

Rerun draws series as lines, bars or points; none of them can be stacked, so the stack is a picture.
"""

from collections import deque
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from operators.visualise.field import WHITE

if TYPE_CHECKING:  # it needs the extra `view`
    from operators.visualise.screen import Screen

COLUMNS, ROWS = 84, 60  # the newest frames; what the whole height is divided into
CELL, LINE = (2, 2), 15  # of the drawing: width and height of a pixel, height of a name
MOST_STAGES = 10  # with a colour of their own; later ones share the last
DARK = np.array((28, 28, 36), np.uint8)
COLOURS = np.array(
    (
        (90, 140, 200), (240, 170, 60), (100, 190, 120), (220, 90, 90), (160, 120, 210),
        (80, 200, 200), (230, 130, 190), (190, 190, 80), (150, 110, 80), (170, 170, 180),
    ),
    np.uint8,
)  # fmt: skip
STEPS = (1, 2, 5, 10)  # of the scale, times a power of ten
OUTLIERS = 95  # percentile of the loop's latencies that the scale has room for


class Stack(NamedTuple):
    """A picture whose lowest row begins at 0 ms and whose highest ends at `full_ms`."""

    shades: NDArray[np.uint8]  # (ROWS, COLUMNS, 3); the newest frame is at the right
    full_ms: float
    names: tuple[str, ...]  # of the stages, from below, with what each took in the median
    colours: NDArray[np.uint8]  # (stages, 3)


class StageStack:
    """What each stage of the loop took, over the last `COLUMNS` frames."""

    def __init__(self) -> None:
        self._frames: deque[dict[str, float]] = deque(maxlen=COLUMNS)

    def add(self, finished_ms: Mapping[str, float]) -> None:
        """Take one frame: when each stage had finished, after the picture, in the loop's order."""
        if finished_ms:
            self._frames.append(dict(finished_ms))

    def picture(self) -> Stack | None:
        """Return the stack; None before the first frame.

        The stages are those of the newest frame. A frame of another graph is left dark.
        """
        if not self._frames:
            return None
        stages = list(self._frames[-1])
        ends = np.zeros((COLUMNS, len(stages)), np.float64)  # ms, 0 where nothing is known
        for column, frame in enumerate(self._frames, COLUMNS - len(self._frames)):
            if list(frame) == stages:
                ends[column] = np.maximum.accumulate(np.maximum(list(frame.values()), 0))
        known = ends[ends[:, -1] > 0]
        full_ms = scale_of(float(np.percentile(known[:, -1], OUTLIERS))) if len(known) else 1.0
        middles = (np.arange(ROWS)[::-1] + 0.5) * full_ms / ROWS  # ms, from the top
        # the stage that works at a moment is the first one that had not finished by then
        working = (ends[None] <= middles[:, None, None]).sum(2)  # (ROWS, COLUMNS)
        own = COLOURS[np.minimum(np.arange(len(stages)), MOST_STAGES - 1)]
        shades = np.concatenate([own, DARK[None]])[working]
        took = np.diff(known, axis=1, prepend=0.0) if len(known) else np.zeros((1, len(stages)))
        names = tuple(
            f"{stage} {ms:.{0 if ms >= 9.95 else 1}f}"
            for stage, ms in zip(stages, np.median(took, axis=0), strict=True)
        )
        return Stack(shades, full_ms, names, own)


def draw(stack: StageStack, period_ms: float, out: "Screen") -> None:
    """Draw the stack with the names of its stages and its scale; a line is one period."""
    if (shown := stack.picture()) is None:
        return
    right, low = COLUMNS * CELL[0], ROWS * CELL[1]
    out.cells("latency/stack/areas", shown.shades, CELL)
    places = [(right + 60, low - LINE * (k + 0.5)) for k in range(len(shown.names))]
    out.texts("latency/stack/names", np.array(places, np.float32), shown.names, shown.colours)
    marks: dict[float, str] = {low: "0", 0: f"{shown.full_ms:g}"}
    lines = []
    if 0 < period_ms < shown.full_ms:
        at = low * (1 - period_ms / shown.full_ms)
        marks[at] = f"frame {period_ms:.0f}"
        lines = [[(0, at), (right, at)]]
    out.lines("latency/stack/budget", lines, WHITE)
    scale = np.array([(-30, at) for at in marks], np.float32)
    out.texts("latency/stack/scale", scale, list(marks.values()), WHITE)


def scale_of(most_ms: float) -> float:
    """Return the least of 1, 2, 5, 10, 20 … ms that is above a value.

    >>> scale_of(26.4), scale_of(51.0), scale_of(0.3)
    (50.0, 100.0, 1.0)
    """
    power = 1.0
    while power * STEPS[-1] < most_ms:
        power *= STEPS[-1]
    return next(step * power for step in STEPS if step * power >= most_ms)
