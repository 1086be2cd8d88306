"""Targets, their start frames and the state of the ball, from the ground truth."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.source import CLASS_OF_ROLE, LEAST_VISIBLE, Annotations
from pipeline.boxes import areas, centres
from pipeline.errors import SettingsError

KINDS = {"ball": "ball", "referee": "main referee", "player": "player"}
PEOPLE = CLASS_OF_ROLE.keys() - {"ball"}
STILL_PX = 1.5  # per frame, at 1920 pixels of width: a slower ball is still
AROUND = 4  # frames before and after over which a ball's state is judged
FREE, STILL, CARRIED = "free", "still", "carried"
Boxes = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Target:
    """One object through a clip of F frames."""

    kind: str  # ball | referee | player
    id: int
    boxes: Boxes  # (F, 4), zeros where it is not in the picture
    visible: NDArray[np.float32]  # (F,) share, 0 where it is not in the picture
    state: tuple[str, ...]  # F of free, still, carried for a ball, else free

    @property
    def there(self) -> NDArray[np.bool_]:
        """The frames in which it is in the truth: (F,)."""
        return np.asarray(self.visible > 0)


def targets(
    truths: Sequence[Annotations], kinds: Sequence[str], *, players: int, seed: int
) -> list[Target]:
    """Return ball, main referee and players of a clip; the seed draws among those long in view."""
    found = []
    for kind in kinds:
        if kind not in KINDS:
            raise SettingsError(f"targets: expected {', '.join(KINDS)}, got {kind}")
        ids = sorted(
            {
                int(i)
                for t in truths
                for i, n in zip(t.ids, t.labels, strict=True)
                if n == KINDS[kind]
            }
        )
        whole = [_target(kind, i, truths) for i in ids]
        whole = [t for t in whole if t.there.mean() > (0.5 if kind == "player" else 0.1)]
        if kind == "player" and len(whole) > players:
            rows = np.sort(np.random.default_rng([seed, 9]).permutation(len(whole))[:players])
            whole = [whole[row] for row in rows]
        found += whole
    return found


def starts(target: Target, every: int) -> list[int]:
    """Return the frames in which a tracker is started: every so many if the target is visible."""
    frames = range(0, len(target.visible) - 1, every)
    return [k for k in frames if target.visible[k] >= LEAST_VISIBLE]


def _target(kind: str, object_id: int, truths: Sequence[Annotations]) -> Target:
    boxes = np.zeros((len(truths), 4), np.float32)
    visible = np.zeros(len(truths), np.float32)
    for k, truth in enumerate(truths):
        row = np.flatnonzero(truth.ids == object_id)
        if len(row) and areas(truth.boxes[row])[0] > 0:
            boxes[k], visible[k] = truth.boxes[row[0]], truth.visibility[row[0]]
    state = ball_states(boxes, truths) if kind == "ball" else (FREE,) * len(truths)
    return Target(kind=kind, id=object_id, boxes=boxes, visible=visible, state=state)


def ball_states(boxes: Boxes, truths: Sequence[Annotations]) -> tuple[str, ...]:
    """Return whether the ball is free, still or carried in each frame, according to the truth.

    Carried: in most frames around, its centre is in the upper three quarters of the same person's
    box. Still: after subtracting the median motion of the people, which is the camera's, it moves
    by less than `STILL_PX` per frame. Free otherwise.
    """
    seen = areas(boxes) > 0
    speed = _speeds(boxes, seen, truths)
    carriers = [
        _carrier(box, truth) if s else -1 for box, truth, s in zip(boxes, truths, seen, strict=True)
    ]
    states = []
    for k in range(len(truths)):
        around = slice(max(k - AROUND, 0), k + AROUND + 1)
        near = np.array(carriers[around])
        known = near[near >= 0]
        if len(known) and np.bincount(known).max() > 0.6 * len(near):
            states.append(CARRIED)
        else:
            slow = speed[around][np.isfinite(speed[around])]
            states.append(STILL if len(slow) and np.median(slow) < STILL_PX else FREE)
    return tuple(states)


def _speeds(
    boxes: Boxes, seen: NDArray[np.bool_], truths: Sequence[Annotations]
) -> NDArray[np.float64]:
    """Return the ball's motion since the frame before, less the people's median: (F,), pixels."""
    speed = np.full(len(boxes), np.nan)
    middle = centres(boxes)
    for k in range(1, len(boxes)):
        if seen[k] and seen[k - 1]:
            speed[k] = np.linalg.norm(middle[k] - middle[k - 1] - _camera(truths[k - 1], truths[k]))
    return speed


def _camera(before: Annotations, now: Annotations) -> NDArray[np.float32]:
    """Return the median motion of all people in both frames: (2,)."""
    both, first, second = np.intersect1d(before.ids, now.ids, return_indices=True)
    if len(both) < 4:
        return np.zeros(2, np.float32)
    motion = centres(now.boxes[second]) - centres(before.boxes[first])
    return np.asarray(np.median(motion, axis=0), np.float32)


def _carrier(ball: NDArray[np.float32], truth: Annotations) -> int:
    """Return the id of the person whose upper three quarters hold the ball's centre, -1: none."""
    x, y = centres(ball)
    for box, label, i in zip(truth.boxes, truth.labels, truth.ids, strict=True):
        left, top, right, bottom = box
        if label in PEOPLE and left <= x <= right and top <= y <= top + 0.75 * (bottom - top):
            return int(i)
    return -1
