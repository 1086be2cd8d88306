"""What is drawn on the field: colours of classes, fading paths and windows, dashed boxes."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.boxes import centres, iou
from pipeline.messages import RoiSchedule, Tracks

Colours = NDArray[np.uint8]  # (n, 3) RGB
Strips = NDArray[np.float32]  # (n, points, 2) x, y in sensor pixels
BALL = (255, 120, 0)
# for the classes in their order; told apart by colour-blind people, too; none is like the ROI's
PALETTE = (
    (86, 180, 233), (204, 121, 167), (0, 200, 140), (213, 94, 0),
    (120, 150, 255), (170, 220, 120), (230, 160, 255), (180, 180, 180),
)  # fmt: skip
YELLOW, WHITE, RED, GREY = (255, 225, 0), (255, 255, 255), (255, 60, 60), (150, 150, 150)
FAINTEST = 0.25  # brightness of the last of a fading row; Rerun's lines have no opacity
MOST_RIMS = 4  # of a plan's windows, from the first to the last; all of them would be one band
SURE_SCORE = 0.4  # from which a track has its full colour
INSET = 0.125  # of a window's width: where its number is, from the corner
DASHES = 3  # on each side of a box
SAME_IOU = 0.2  # of an answer with a track, from which it is drawn
SAME_SHARE = 0.05  # of a window's width: planned windows no further apart have one number


def class_colour(name: str, label: int) -> tuple[int, int, int]:
    """Return the colour of a class, the same in every frame."""
    return BALL if "ball" in name else PALETTE[label % len(PALETTE)]


def track_colours(tracks: Tracks) -> Colours:
    """Return the colour of each track by its class, darker for a doubtful one: (n, 3)."""
    rows = [class_colour(tracks.name_of(i), int(k)) for i, k in enumerate(tracks.labels)]
    bright = (tracks.scores / SURE_SCORE).clip(FAINTEST, 1)[:, None]
    return np.asarray(np.array(rows, np.float32).reshape(-1, 3) * bright, np.uint8)


def full(colours: Colours) -> Colours:
    """Return the colours as bright as they can be: (n, 3) -> (n, 3)."""
    most = np.maximum(colours.max(axis=1, keepdims=True, initial=1), 1)
    return np.asarray(colours * (255 / most), np.uint8)


def fading(colours: Colours, count: int) -> Colours:
    """Return each colour `count` times, ever darker: (n, 3) -> (n * count, 3)."""
    share = np.linspace(1, FAINTEST, count)[:, None]
    return (colours[:, None] * share).astype(np.uint8).reshape(-1, 3)


def paths(tracks: Tracks) -> tuple[Strips, Colours]:
    """Return where the tracks will be, as one line from frame to frame: fainter the later."""
    at = centres(np.concatenate([tracks.boxes[:, -1:], tracks.predicted], axis=1))
    steps = np.stack([at[:, :-1], at[:, 1:]], axis=2)  # (n, horizon, 2, 2)
    return steps.reshape(-1, 2, 2), fading(track_colours(tracks), at.shape[1] - 1)


def dashed(boxes: NDArray[np.float32]) -> Strips:
    """Return the outlines of boxes as dashes: (n, 4) -> (n * 4 * DASHES, 2, 2).

    >>> dashed(np.array([[0, 0, 5, 5]], np.float32))[:3, :, 0].tolist()
    [[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]
    """
    corners = boxes.reshape(-1, 4)[:, [0, 1, 2, 1, 2, 3, 0, 3]].reshape(-1, 4, 1, 1, 2)
    following = np.roll(corners, -1, axis=1)
    at = np.arange(2 * DASHES, dtype=np.float32).reshape(DASHES, 2, 1) / (2 * DASHES - 1)
    return np.asarray(corners + (following - corners) * at, np.float32).reshape(-1, 2, 2)


def on_tracks(boxes: NDArray[np.float32], tracks: Tracks | None) -> NDArray[np.intp]:
    """Return which of the boxes (n, 4) lie on a track, the best one of each.

    A reader tells what it read long ago, too, where it thinks that is by now. Without tracks: all.
    """
    if tracks is None:
        return np.arange(len(boxes))
    overlaps = iou(tracks.boxes[:, -1], boxes)
    if not overlaps.size:
        return np.zeros(0, np.intp)
    best = overlaps.argmax(1)
    return np.unique(best[overlaps.max(1) >= SAME_IOU])


class Planned(NamedTuple):
    """Some windows that the sensor was told, first and last among them, and their numbers."""

    boxes: NDArray[np.float32]  # (n, 4)
    colours: Colours
    places: NDArray[np.float32]  # (k, 2), where the numbers are, on the upper edges
    numbers: Sequence[str]  # k, frames ahead of the exposure that the plan was made from


def planned(schedule: RoiSchedule) -> Planned:
    """Return the windows of a sensor command that are read, `MOST_RIMS` frames of them."""
    rows = schedule.windows.reshape(len(schedule.windows), -1, 4)
    read = (rows[..., 2] > rows[..., 0]).any(axis=1)
    frames = np.flatnonzero(read)
    if not len(frames):
        none = np.zeros((0, 4), np.float32)
        return Planned(none, np.zeros((0, 3), np.uint8), none[:, :2], ())
    shown = frames[np.unique(np.linspace(0, len(frames) - 1, MOST_RIMS).round().astype(int))]
    k, which = np.nonzero(rows[shown, :, 2] > rows[shown, :, 0])
    boxes = rows[shown[k], which].astype(np.float32)
    colours = fading(np.array([YELLOW], np.uint8), len(rows))[shown[k]]
    ahead = schedule.first_seq + shown[[0, -1]] - schedule.header.seq
    first, last = (f"+{frames}" for frames in ahead)
    apart = np.abs(boxes[-1, :2] - boxes[0, :2]).max()
    if len(boxes) == 1 or apart <= SAME_SHARE * (boxes[0, 2] - boxes[0, 0]):
        numbers = [first if first == last else f"{first} to {last}"]
        return Planned(boxes, colours, _along_top(boxes[:1], 0.5), numbers)
    # at opposite ends, because the windows hardly move: top right of the first, left of the last
    places = [_along_top(boxes[:1], 1 - INSET), _along_top(boxes[-1:], INSET)]
    return Planned(boxes, colours, np.concatenate(places), [first, last])


def _along_top(boxes: NDArray[np.float32], share: float) -> NDArray[np.float32]:
    """Return a place on the upper edge of each box, from its left: (n, 4) -> (n, 2)."""
    across = boxes[:, 0] + share * (boxes[:, 2] - boxes[:, 0])
    return np.stack([across, boxes[:, 1]], axis=1).astype(np.float32)


def named(
    names: tuple[str, ...], labels: NDArray[np.int32], scores: NDArray[np.float32] | None = None
) -> list[str]:
    """A text per object: its class and, if given, its score.

    >>> named(("ball",), np.array([0, 7], np.int32), np.array([0.5, 0.25], np.float32))
    ['ball 0.50', 'class 7 0.25']
    """
    texts = [names[i] if 0 <= i < len(names) else f"class {i}" for i in labels]
    if scores is None:
        return texts
    return [f"{text} {score:.2f}" for text, score in zip(texts, scores, strict=True)]
