"""Figures of one start beside its mean IoU: success, precision and the frames until it is lost."""

from collections.abc import Sequence
from dataclasses import dataclass

SUCCESS_IOU = 0.5
PRECISION_PX = 20.0
LOST_IOU = 0.1  # below it the box is not on the target
LOST_FRAMES = 10  # in succession, from which the target counts as lost


@dataclass(frozen=True, kw_only=True)
class Figures:
    """Counts over the scored frames of a start in which the target is in the truth."""

    frames: int
    hits: int  # IoU of `SUCCESS_IOU` or more
    near: int  # centres at most `PRECISION_PX` apart
    until_lost: int  # frames before the target is lost; all of them where it is not
    lost: bool


def figures_of(iou: Sequence[float], away_px: Sequence[float]) -> Figures:
    """Return the figures of a start.

    >>> figures_of([0.8] * 4 + [0.0] * 12, [3.0] * 4 + [99.0] * 12)
    Figures(frames=16, hits=4, near=4, until_lost=4, lost=True)
    >>> figures_of([0.8, 0.0, 0.8], [3.0, 30.0, 3.0]).until_lost
    3
    """
    until, lost = kept_for(iou)
    return Figures(
        frames=len(iou),
        hits=sum(value >= SUCCESS_IOU for value in iou),
        near=sum(value <= PRECISION_PX for value in away_px),
        until_lost=until,
        lost=lost,
    )


def kept_for(iou: Sequence[float]) -> tuple[int, bool]:
    """Return the frames before the first `LOST_FRAMES` beside the target, and if there are any."""
    missed = 0
    for k, value in enumerate(iou):
        missed = missed + 1 if value < LOST_IOU else 0
        if missed == LOST_FRAMES:
            return k + 1 - LOST_FRAMES, True
    return len(iou), False
