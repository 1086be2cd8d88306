"""Count texts that were read: Percept, Truth -> share of legible texts transcribed correctly.

The metric of the paper's text task. An instance is legible if the truth has a transcription of it
in at least one frame (`###`: none); it is transcribed once a percept says the same at its place.
Letter case, spaces and punctuation do not count.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.boxes import centres, iou
from pipeline.contract import HEADLINE, Input, Operator
from pipeline.errors import MessageError
from pipeline.messages import Header, Percept, Truth

ILLEGIBLE = "###"
SAME_IOU = 0.3
MOST_TEXTS = 100_000  # remembered
MOST_SAID = 32  # readings of one text before it is legible


@dataclass(kw_only=True)
class Known:
    """What is known of one instance; frames are sequence numbers."""

    text: str = ""  # empty: never legible
    legible_seq: int = -1
    read_seq: int = -1  # first correct reading
    nearly_seq: int = -1  # first reading with at most one edit
    said: set[str] = field(default_factory=set)  # before it was legible

    def settle(self, seq: int) -> None:
        """Compare what was said with what it says."""
        for text in self.said:
            if self.read_seq < 0 and text == self.text:
                self.read_seq = seq
            if self.nearly_seq < 0 and edits(text, self.text) <= 1:
                self.nearly_seq = seq
        self.said.clear()


class Tally:
    """Counts over one stream."""

    def __init__(self) -> None:
        self.known: dict[int, Known] = {}

    def add(self, percept: Percept, truth: Truth) -> None:
        """Count one frame; raises `MessageError` for a truth whose labels do not fit its boxes."""
        if len(truth.labels) != len(truth.boxes):
            got = f"{len(truth.labels)} for {len(truth.boxes)} boxes"
            raise MessageError(f"truth.labels: expected one for each box, got {got}")
        seq = truth.header.seq
        for id_, label in zip(truth.ids.tolist(), truth.labels, strict=True):
            if id_ not in self.known and len(self.known) >= MOST_TEXTS:
                continue
            each = self.known.setdefault(id_, Known())
            if label != ILLEGIBLE and not each.text:
                each.text, each.legible_seq = plain(label), seq
                each.settle(seq)
        pairs = matches(percept.boxes, truth.boxes)
        for row, column in pairs:
            each = self.known.get(int(truth.ids[column]), Known())
            if row < len(percept.texts):
                each.said.add(plain(percept.texts[row]))
                if each.text:
                    each.settle(seq)
                elif len(each.said) > MOST_SAID:
                    each.said.clear()

    def counts(self) -> dict[str, int]:
        """Return how many were legible, read, and read but for one edit."""
        legible = [each for each in self.known.values() if each.text]
        return {
            "legible": len(legible),
            "read": sum(each.read_seq >= 0 for each in legible),
            "nearly": sum(each.nearly_seq >= 0 for each in legible),
        }

    def waits(self) -> list[int]:
        """Return frames from legible to read, of those that were read."""
        return [
            max(0, each.read_seq - each.legible_seq)
            for each in self.known.values()
            if each.text and each.read_seq >= 0
        ]


@dataclass(frozen=True, kw_only=True)
class TranscribedSettings:
    """Nothing to set."""


class Transcribed(Operator[TranscribedSettings, None]):
    """Sends nothing; its figures are shown while the graph runs, and in the report."""

    percept = Input(Percept, keep="latest")
    truth = Input(Truth, keep="latest")

    def open(self) -> None:
        """Start with empty counts."""
        self._tally, self._frames = Tally(), 0

    def on_stream(self, header: Header) -> None:
        """Ids of another stream are other texts."""
        self._tally, self._frames = Tally(), 0

    def on_percept_truth(self, percept: Percept, truth: Truth) -> None:
        """Count one frame."""
        self._frames += 1
        self._tally.add(percept, truth)

    def summary(self) -> Mapping[str, Any]:
        """Return the counts and the share."""
        counts = self._tally.counts()
        share = counts["read"] / counts["legible"] if counts["legible"] else 0.0
        line = f"read {counts['read']} of {counts['legible']} legible texts"
        if not self._frames:
            line = "texts that were read: not known, the source has no truth"
        elif not counts["legible"]:
            line = "texts that were read: not known, the truth has no legible one"
        return {**counts, "transcribed": round(share, 4), HEADLINE: line}

    def headline(self) -> str:
        """Return how many of the legible texts were read."""
        counts = self._tally.counts()
        return f"read {counts['read']} of {counts['legible']}"

    def state(self) -> None:
        """Return None: the counts begin anew with another instance."""


def matches(found: NDArray[np.float32], truth: NDArray[np.float32]) -> list[tuple[int, int]]:
    """Return pairs (row, column) of boxes (n, 4) and (m, 4) at the same place.

    Two are if they overlap enough, or the middle of the one found is in the true one. Each of those
    found is at one place at most: the one with the greatest overlap.
    """
    if not len(found) or not len(truth):
        return []
    overlaps, middles = iou(found, truth), centres(found)
    inside = (
        (middles[:, None] >= truth[None, :, :2]) & (middles[:, None] <= truth[None, :, 2:])
    ).all(2)
    score = np.where((overlaps >= SAME_IOU) | inside, overlaps + 1e-6, 0)
    best = score.argmax(1)
    return [(row, int(best[row])) for row in range(len(found)) if score[row, best[row]] > 0]


def plain(text: str) -> str:
    """Return what counts of a text.

    >>> plain("Adams & Sons."), plain("K7 - lm")
    ('ADAMSSONS', 'K7LM')
    """
    return "".join(letter for letter in text.upper() if letter.isalnum())


def edits(a: str, b: str) -> int:
    """Return the letters to insert, remove or change that make one text the other; at most 2.

    >>> edits("BAKERY", "BAKFRY"), edits("BAKERY", "BAKER"), edits("CAFE", "TAXI")
    (1, 1, 2)
    """
    if abs(len(a) - len(b)) > 1:
        return 2
    before = list(range(len(b) + 1))
    for i, one in enumerate(a, 1):
        row = [i]
        for j, other in enumerate(b, 1):
            row.append(min(before[j] + 1, row[j - 1] + 1, before[j - 1] + (one != other)))
        before = row
    return min(before[-1], 2)
