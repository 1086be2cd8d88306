"""What the consumer sees: its box at full resolution corrects where a target is believed to be.

The detector sees the context only; the consumer also sees the ROI. While no detection shows the
target, the consumer's box takes the place of the one that was foreseen. The paper names feedback
from the consumer as open work (section 5).
"""

from dataclasses import dataclass, field, replace

import numpy as np

from operators.policy.gaze_plan import row_of
from operators.policy.motion import camera_motion
from operators.policy.target import GROWTH, TargetState, alike
from operators.policy.tokens import Array
from pipeline import Percept, Tracks
from pipeline.boxes import centres, sizes

LATEST = 4  # frames after which a box is too old
FAR_PX = 2.0**20  # beyond any field


def _nowhere() -> Array:
    return np.zeros(4, np.float32)


@dataclass(frozen=True, kw_only=True, eq=False)
class Consumer:
    """The consumer's last answer."""

    seq: int = -1  # its frame; -1: none yet
    box: Array = field(default_factory=_nowhere)  # sensor pixels; zeros: it is lost
    object_id: int = -1  # the track that it follows
    score: float = 0.0


def consumer_of(percept: Percept) -> Consumer:
    """Return the first box of an answer; none of one that is lost or not finite."""
    seq = percept.header.seq
    if not len(percept.boxes) or not (np.abs(percept.boxes[0]) < FAR_PX).all():
        return Consumer(seq=seq)
    return Consumer(
        seq=seq, box=percept.boxes[0], object_id=int(percept.ids[0]),
        score=float(percept.scores[0]),
    )  # fmt: skip


def corrected(
    target: TargetState, consumer: Consumer, tracks: Tracks, least_score: float
) -> TargetState:
    """Return the target with its box where the consumer sees it, if no detection shows it.

    The consumer must follow the same track, be sure enough, and be no further away than the target
    can have moved since it was seen. How long the target has not been detected stays as it is.
    """
    row = row_of(tracks, target.bound_id)
    late = tracks.header.seq - consumer.seq
    if (
        not target.placed
        or (row >= 0 and tracks.visible[row, -1])
        or consumer.seq < 0
        or not 0 <= late <= LATEST
        or target.bound_id < 0
        or consumer.object_id != target.bound_id
        or not consumer.score >= least_score
        or not alike(consumer.box[None], target.box)[0]
    ):
        return target
    box = consumer.box + late * np.tile(camera_motion(tracks), 2)
    away = float(np.linalg.norm(centres(box) - centres(target.box)))
    gone = max(tracks.header.seq - target.seen_seq, 1)
    reach = (1 + GROWTH * gone) * float(sizes(target.box[None])[0])
    if away > reach + 0.25 * tracks.header.geometry.roi_width_px:
        return target
    return replace(target, box=np.asarray(box, np.float32))
