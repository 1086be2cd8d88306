"""A template tracker without weights: normalised correlation over positions and sizes.

Two templates are compared with the search picture, the initial one and a slowly updated one: the
latter adapts to changes of light, pose and resolution, the former prevents drift. The search is
centred on the position extrapolated from the last motion, and a window prefers positions nearby.

A box from a policy may be some pixels beside the object, and a template keeps that offset. The
offset is estimated while policy and tracker follow the same object, and removed.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from operators.tracker.following import Memory, Method
from operators.tracker.look import Picture, Streams
from operators.tracker.tracker import Tracker, TrackerSettings
from pipeline.boxes import centres, from_centres

TEMPLATE_PX = 32  # of a look twice as wide as the object: 16 px for the object itself
SEARCH_PX = 96  # of a look six times as wide, at the same scale
FACTOR = 2.0
SCALES = (0.95, 1.0, 1.05)
SCALE_COST = 0.02  # penalty of another size
RENEWAL = 0.05  # weight of a new view in the updated template
TRUSTED = 0.6  # minimum score of a view for an update
SPEED_GAIN = 0.5
WINDOW_WEIGHT = 0.25  # of the preference for the foreseen place
ALIGN_GAIN = 0.2  # share of what the box and the foreseen one differ by that is taken over
SHAPES = ((TEMPLATE_PX, TEMPLATE_PX, 3), (TEMPLATE_PX, TEMPLATE_PX, 3), (2,), (2,))  # of a memory
Box = NDArray[np.float32]  # (4,) xyxy, sensor pixels


@dataclass(frozen=True, kw_only=True)
class CorrelationSettings(TrackerSettings):
    """What a graph may set."""


class CorrelationTracker(Tracker[CorrelationSettings]):
    """Needs no weights."""

    def method(self) -> Method:
        """Correlation."""
        return Correlation()


class Correlation:
    """Follows one object by its appearance."""

    patience_score, provider = 0.35, ""

    def __init__(self) -> None:
        ramp = np.hanning(SEARCH_PX - TEMPLATE_PX + 3)[1:-1].astype(np.float32)
        self._window = 1 - WINDOW_WEIGHT * (1 - np.outer(ramp, ramp))

    def start(self, streams: Streams, box: Box) -> None:
        """Take the template."""
        look = streams.look(centres(box), FACTOR * scale_of(box), TEMPLATE_PX)
        template, still = look.astype(np.float32), np.zeros(2, np.float32)
        self.resume((template, template, still, still))

    def memory(self) -> Memory:
        """First and renewed template, velocity, and the template's place beside the object."""
        return self._first, self._renewed, self._velocity, self._offset

    def resume(self, memory: Memory) -> bool:
        """Take over another instance's memory."""
        if tuple(part.shape for part in memory) != SHAPES:
            return False
        first, renewed, velocity, offset = (part.astype(np.float32) for part in memory)
        self._first, self._renewed = first, renewed
        self._velocity = velocity  # px per call
        self._offset = offset  # of the object's centre from the template's, in its scale
        return True

    def follow(self, streams: Streams, box: Box) -> tuple[Box, float]:
        """Return the object's box, given the previous one, and a confidence 0..1."""
        scale = scale_of(box)
        before = centres(box) - scale * self._offset  # of the template
        foreseen = before + self._velocity
        score, zoom, moved = -1.0, 1.0, np.zeros(2, np.float32)
        for tried in SCALES:
            side = FACTOR * scale * tried * SEARCH_PX / TEMPLATE_PX
            value, shift = self._match(streams.look(foreseen, side, SEARCH_PX))
            value -= SCALE_COST * (tried != 1)
            if value > score:
                score, zoom, moved = value, tried, shift * np.float32(side / SEARCH_PX)
        centre = foreseen + moved
        if score > self.patience_score:
            step = SPEED_GAIN * (centre - before - self._velocity)
            self._velocity = self._velocity + step
        if score > TRUSTED:
            look = streams.look(centre, FACTOR * scale * zoom, TEMPLATE_PX)
            self._renewed += RENEWAL * (look - self._renewed)
        middle = (centre + scale * zoom * self._offset).astype(np.float32)
        size = np.asarray((box[2:] - box[:2]) * zoom, np.float32)
        return from_centres(middle, size), float(np.clip(score, 0, 1))

    def aligned(self, box: Box, foreseen: Box) -> Box:
        """The box, a step nearer to the foreseen one in place and size."""
        step = ALIGN_GAIN * (centres(foreseen) - centres(box))
        size = box[2:] - box[:2]
        grown = np.asarray(size + ALIGN_GAIN * (foreseen[2:] - foreseen[:2] - size), np.float32)
        self._offset = (self._offset + step / np.float32(scale_of(box))).astype(np.float32)
        return from_centres(centres(box) + step, grown)

    def _match(self, look: Picture) -> tuple[float, NDArray[np.float32]]:
        """Best correlation and its offset (x, y) from the middle, in pixels of the look."""
        search = look.astype(np.float32)
        mode = cv2.TM_CCOEFF_NORMED
        response = np.maximum(
            cv2.matchTemplate(search, self._first, mode),
            cv2.matchTemplate(search, self._renewed, mode),
        )
        # a look without any structure has no correlation: 0 / 0
        weighted = np.nan_to_num(response, nan=0.0, posinf=0.0, neginf=0.0) * self._window
        row, column = np.unravel_index(int(weighted.argmax()), weighted.shape)
        peak = np.array([column, row], np.float32) + refined(weighted, int(row), int(column))
        return float(weighted[row, column]), peak - (SEARCH_PX - TEMPLATE_PX) / 2


def scale_of(box: Box) -> float:
    """Root of the area, at least 4 pixels."""
    width, height = box[2:] - box[:2]
    return float(max(np.sqrt(max(width * height, 0)), 4))


def refined(response: NDArray[np.float32], row: int, column: int) -> NDArray[np.float32]:
    """How far the true peak lies from its cell, by a parabola each way: (x, y) within ±0.5.

    >>> refined(np.array([[2, 4, 4]], np.float32), 0, 1).tolist()
    [0.5, 0.0]
    """
    offset = np.zeros(2, np.float32)
    height, width = response.shape
    if 0 < column < width - 1:
        offset[0] = vertex(*(float(v) for v in response[row, column - 1 : column + 2]))
    if 0 < row < height - 1:
        offset[1] = vertex(*(float(v) for v in response[row - 1 : row + 2, column]))
    return offset


def vertex(before: float, peak: float, after: float) -> float:
    """Where the parabola through three equidistant values has its top, from the middle one."""
    bend = before - 2 * peak + after
    return 0.5 * (before - after) / bend if bend < 0 else 0.0
