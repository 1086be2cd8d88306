"""Made-up tracks for the tests of the policy."""

import numpy as np

from operators.policy.target import Choice, TargetSpec, TargetState, follow
from pipeline import Tracks
from pipeline.testing import header

NAMES = ("ball", "player")


def tracks(
    seq: int,
    *objects: tuple[int, int, float, float, float],
    unseen: tuple[int, ...] = (),
    channels: int = 0,
) -> Tracks:
    """Return tracks (id, label, centre x, centre y, speed x) in `seq`; balls 16 px, players 40."""
    rows = np.array(objects, np.float32).reshape(-1, 5)
    labels = rows[:, 1].astype(np.int32)
    half = np.where(labels == 0, 8, 20).astype(np.float32)[:, None, None]
    frames = np.arange(-3, 17)
    centre = np.stack(
        [rows[:, 2:3] + frames * rows[:, 4:5], np.tile(rows[:, 3:4], len(frames))], axis=-1
    )
    boxes = np.concatenate([centre - half, centre + half], axis=-1).astype(np.float32)
    visible = np.ones((len(rows), 4), np.bool_)
    visible[np.isin(rows[:, 0], unseen), -1] = False
    return Tracks(
        header=header(seq),
        ids=rows[:, 0].astype(np.int32),
        labels=labels,
        scores=np.full(len(rows), 0.5, np.float32),
        boxes=boxes[:, :4],
        visible=visible,
        features=np.ones((len(rows), 4, channels), np.float32) * rows[:, :1, None],
        predicted=boxes[:, 4:],
        names=NAMES,
    )


def followed(spec: TargetSpec, *frames: Tracks, chosen: Choice | None = None) -> TargetState:
    """Return the state of a target after these frames, with the same choice in each."""
    target = TargetState()
    for world in frames:
        target = follow(target, spec, world, chosen or Choice())
    return target
