"""Collect readings of the same text over frames: readings -> instances, by box and by vote.

An instance keeps its id as long as its box, carried on with constant velocity, meets a reading that
overlaps it, or one near it that says the same. What it says is what most readings say, weighted by
their scores.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from operators.reader.ocr import Reading
from pipeline.boxes import iou

MOST_INSTANCES = 256  # kept
MOST_VOTES = 8  # different texts of an instance
SAME_IOU = 0.2  # from which a reading is of an instance
NEAR = 3.0  # heights of the box within which a reading that says the same is of it
EASE = 0.5  # share of the newest velocity
Box = NDArray[np.float32]  # (4,) xyxy, sensor pixels


@dataclass(kw_only=True, eq=False)
class Instance:
    """One text of the world, as far as it was read."""

    id: int
    box: Box
    seq: int  # frame of the last reading
    velocity: Box = field(default_factory=lambda: np.zeros(4, np.float32))  # per frame
    votes: dict[str, float] = field(default_factory=dict)  # text -> sum of scores
    best: dict[str, float] = field(default_factory=dict)  # text -> greatest score

    def at(self, seq: int) -> Box:
        """Return where its box is in a frame."""
        moved = self.box + self.velocity * (seq - self.seq)
        return np.concatenate([np.minimum(moved[:2], moved[2:]), np.maximum(moved[:2], moved[2:])])

    @property
    def text(self) -> str:
        """What it says."""
        return max(self.votes, key=lambda text: self.votes[text])

    @property
    def score(self) -> float:
        """How sure that is: its best score, less the share of votes that say something else."""
        return self.best[self.text] * self.votes[self.text] / sum(self.votes.values())

    def hear(self, reading: Reading, box: Box, seq: int) -> None:
        """Add a reading of frame `seq` with its box in sensor pixels."""
        if seq > self.seq:
            newest = (box - self.box) / (seq - self.seq)
            known = bool(self.velocity.any())
            self.velocity = (
                EASE * newest + (1 - EASE) * self.velocity if known else newest
            ).astype(np.float32)
        self.box, self.seq = box, seq
        if reading.text not in self.votes and len(self.votes) >= MOST_VOTES:
            least = min(self.votes, key=lambda text: self.votes[text])
            del self.votes[least], self.best[least]
        self.votes[reading.text] = self.votes.get(reading.text, 0.0) + reading.score
        self.best[reading.text] = max(self.best.get(reading.text, 0.0), reading.score)


class Instances:
    """All texts read of late."""

    def __init__(self, forget_after: int) -> None:
        self.forget_after = forget_after  # frames without a reading
        self.kept: list[Instance] = []
        self.next_id = 1

    def hear(self, readings: list[Reading], boxes: NDArray[np.float32], seq: int) -> None:
        """Add the readings of a frame; `boxes` (n, 4) are theirs in sensor pixels."""
        self.kept = [each for each in self.kept if seq - each.seq <= self.forget_after]
        free = list(self.kept)
        order = sorted(range(len(readings)), key=lambda i: -readings[i].score)
        for i in order:
            mine = _best(free, readings[i], boxes[i], seq)
            if mine is None:
                mine = Instance(id=self.next_id, box=boxes[i], seq=seq)
                self.next_id += 1
                self.kept.append(mine)
            else:
                free.remove(mine)
            mine.hear(readings[i], boxes[i], seq)
        if len(self.kept) > MOST_INSTANCES:
            self.kept = sorted(self.kept, key=lambda each: each.seq)[-MOST_INSTANCES:]

    def in_view(self, seq: int, size_px: tuple[int, int]) -> list[tuple[Instance, Box]]:
        """Return those whose box is in the field in frame `seq`, with that box clipped."""
        most = np.array([*size_px, *size_px], np.float32)
        found = []
        for each in self.kept:
            box = np.clip(each.at(seq), 0, most).astype(np.float32)
            if (box[2:] - box[:2]).min() >= 1:
                found.append((each, box))
        return found


def _best(free: list[Instance], reading: Reading, box: Box, seq: int) -> Instance | None:
    """Return the instance that a reading is of, None for a new one."""
    if not free:
        return None
    there = np.array([each.at(seq) for each in free], np.float32)
    overlaps = iou(there, box[None])[:, 0]
    best = int(overlaps.argmax())
    if overlaps[best] >= SAME_IOU:
        return free[best]
    reach = NEAR * float(box[3] - box[1])
    away = np.abs((there[:, :2] + there[:, 2:]) / 2 - (box[:2] + box[2:]) / 2).max(1)
    same = [i for i in np.argsort(away) if away[i] <= reach and free[i].text == reading.text]
    return free[same[0]] if same else None
