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
STILL_PX = 1.5  # per frame, at `STILL_WIDTH_PX`: a slower ball is still
STILL_WIDTH_PX = 1920  # of the field; a wider one shows the same motion in more pixels
AROUND = 4  # frames before and after over which a ball's state is judged
CARRIED_FRAMES = 5  # in succession, at the same person
WITH_PERSON = 0.1  # of a person's height a frame: what moves less against the person moves with it
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
    truths: Sequence[Annotations], kinds: Sequence[str], *, players: int, seed: int, width_px: int
) -> list[Target]:
    """Return ball, main referee and players of a clip; the seed draws among those long in view.

    `width_px` is the width of its pictures.
    """
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
        whole = [_target(kind, i, truths, width_px) for i in ids]
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


def _target(kind: str, object_id: int, truths: Sequence[Annotations], width_px: int) -> Target:
    boxes = np.zeros((len(truths), 4), np.float32)
    visible = np.zeros(len(truths), np.float32)
    for k, truth in enumerate(truths):
        row = np.flatnonzero(truth.ids == object_id)
        if len(row) and areas(truth.boxes[row])[0] > 0:
            boxes[k], visible[k] = truth.boxes[row[0]], truth.visibility[row[0]]
    state = ball_states(boxes, truths, width_px) if kind == "ball" else (FREE,) * len(truths)
    return Target(kind=kind, id=object_id, boxes=boxes, visible=visible, state=state)


def ball_states(boxes: Boxes, truths: Sequence[Annotations], width_px: int) -> tuple[str, ...]:
    """Return whether the ball is free, still or carried in each frame, according to the truth.

    Carried: for `CARRIED_FRAMES` frames in succession or more, its centre is in the box of the same
    person and moves with that person, whatever the policy takes for carried. Still: after
    subtracting the median motion of the people, which is the camera's, it moves by less than
    `STILL_PX` per frame, in proportion to the width of the pictures. Free otherwise.
    """
    still_px = STILL_PX * width_px / STILL_WIDTH_PX
    seen = areas(boxes) > 0
    speed = _speeds(boxes, seen, truths)
    carried = _carried(boxes, seen, truths)
    states = []
    for k in range(len(truths)):
        around = slice(max(k - AROUND, 0), k + AROUND + 1)
        slow = speed[around][np.isfinite(speed[around])]
        still = len(slow) and np.median(slow) < still_px
        states.append(CARRIED if carried[k] else STILL if still else FREE)
    return tuple(states)


def _carried(
    boxes: Boxes, seen: NDArray[np.bool_], truths: Sequence[Annotations]
) -> NDArray[np.bool_]:
    """Return in which frames a person carries the ball: (F,)."""
    found = np.zeros(len(boxes), np.bool_)
    for person in sorted({int(i) for truth in truths for i in truth.ids}):
        begun = 0
        before: NDArray[np.float64] | None = None  # from the person's middle, in its heights
        for k in range(len(boxes) + 1):
            place = _place(boxes[k], truths[k], person) if k < len(boxes) and seen[k] else None
            moved = before is None or place is None or _apart(before, place) > WITH_PERSON
            if moved:
                if k - begun >= CARRIED_FRAMES and before is not None:
                    found[begun:k] = True
                begun = k
            before = place
    return found


def _place(
    ball: NDArray[np.float32], truth: Annotations, person: int
) -> NDArray[np.float64] | None:
    """Return where in a person's box the ball's centre is, in its heights; None: outside."""
    for box, label, i in zip(truth.boxes, truth.labels, truth.ids, strict=True):
        x, y = centres(ball)
        if int(i) == person and label in PEOPLE and box[0] <= x <= box[2] and box[1] <= y <= box[3]:
            return np.asarray((centres(ball) - centres(box)) / (box[3] - box[1]), np.float64)
    return None


def _apart(before: NDArray[np.float64], now: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(now - before))


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
