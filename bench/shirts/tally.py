"""Count identities: what tracks are called and who they truly are, frame by frame -> shares.

A player is legible if the truth has the number in at least one frame at full resolution. It is read
once a track on the player has the number. From then on, each frame in which the player is in view
counts: the track on it may have the right number, another one, or none. Where several tracks are on
one player each has its own name, so that a frame may have both a right and a wrong one.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from drivers.source import Annotations
from operators.transcribed import ILLEGIBLE
from pipeline.boxes import centres, iou
from pipeline.messages import Percept

SAME_IOU = 0.4  # of a named track and a player
SEEN = 0.5  # visible share of a player in view


@dataclass(frozen=True, kw_only=True)
class Counts:
    """What a clip has come to; frames are those of players."""

    legible: int  # players
    read: int  # of them
    kept: int  # frames in view after the first right name, with the right one
    wrong: int  # of the same, with another one, on a second track perhaps
    after: int  # of the same, in all
    named: int  # tracks with a name, over all frames
    named_rightly: int  # of them
    waits: tuple[int, ...]  # frames from legible to read


@dataclass(kw_only=True)
class IdentityTally:
    """Counts of one clip."""

    numbers: dict[int, str]  # of each player
    legible: dict[int, int] = field(default_factory=dict)  # player -> first frame
    read: dict[int, int] = field(default_factory=dict)
    kept: int = 0
    wrong: int = 0
    after: int = 0
    named: int = 0
    named_rightly: int = 0

    def add(self, seq: int, percept: Percept, people: Annotations, shirts: Annotations) -> None:
        """Count one frame: names of tracks, true boxes of people, true numbers on backs."""
        for id_, label in zip(shirts.ids.tolist(), shirts.labels, strict=True):
            if label != ILLEGIBLE and id_ in self.numbers:
                self.legible.setdefault(id_, seq)
        said = said_of(percept, people)
        self.named += len(percept.texts)
        for id_, names in said.items():
            right = sum(self.numbers.get(id_, "") in words for words in names)
            self.named_rightly += right
            if right:
                self.read.setdefault(id_, seq)
        seen = people.visibility >= SEEN
        for id_ in people.ids[seen].tolist():
            if id_ in self.read and self.read[id_] < seq:
                each = [self.numbers[id_] in words for words in said.get(id_, ())]
                self.after += 1
                self.kept += any(each)
                self.wrong += not all(each)

    def counts(self) -> Counts:
        """Return the counts.

        `legible`, `read` and `waits` are of players whom the truth calls legible in some frame;
        frames and names are of all players.
        """
        read = [id_ for id_ in self.legible if id_ in self.read]
        return Counts(
            legible=len(self.legible),
            read=len(read),
            kept=self.kept,
            wrong=self.wrong,
            after=self.after,
            named=self.named,
            named_rightly=self.named_rightly,
            waits=tuple(max(0, self.read[i] - self.legible[i]) for i in read),
        )


Names = tuple[tuple[str, ...], ...]  # of one person: the words of each track on it


def said_of(percept: Percept, people: Annotations) -> dict[int, Names]:
    """Return what the tracks on each person are called, by the person's id."""
    found: dict[int, Names] = {}
    if not len(percept.boxes) or not len(people.boxes):
        return found
    shared = iou(percept.boxes, people.boxes.astype(np.float32))
    for row, best in enumerate(shared.argmax(1).tolist()):
        words = tuple(percept.texts[row].split())
        if words and shared[row, best] >= SAME_IOU:
            id_ = int(people.ids[best])
            found[id_] = (*found.get(id_, ()), words)
    return found


def on_people(percept: Percept, people: Annotations) -> Percept:
    """Return an answer with the boxes of the people on whom its texts are; others are left out."""
    true = people.boxes.astype(np.float32)
    middle = centres(percept.boxes)[:, None]
    inside: NDArray[np.bool_] = np.all(
        (middle >= true[None, :, :2]) & (middle <= true[None, :, 2:]), axis=2
    )
    rows = np.flatnonzero(inside.sum(1) == 1)
    return replace(
        percept,
        boxes=true[inside[rows].argmax(1)] if len(rows) else percept.boxes[:0],
        ids=percept.ids[rows],
        scores=percept.scores[rows],
        texts=tuple(percept.texts[row] for row in rows),
    )
