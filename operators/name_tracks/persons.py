"""What is known of each person: votes for numbers and names, colour of the shirt, last place.

A person has one track at a time. When that ends, the person is lost, and may be found again: by a
new track that begins where it could be by now, or by a reading that says the same on a like shirt.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pipeline import Tracks
from pipeline.boxes import centres

Array = NDArray[np.float32]

MOST_PERSONS = 256  # kept
MOST_TEXTS = 8  # different ones of a person
MOST_VOTES = 6.0  # that are kept: so many sure readings outvote any past
CHANCE = 0.5  # score of a reading that is worth no vote; one of 1 is worth a whole one
HALF = 0.5  # share of a vote for a single digit
EASE = 1e-3  # votes, against rounding
SURE_LOOKS = 5  # from which a shirt's colour is known
CHANGED_LOOKS = 3  # in another colour, from which the track is on somebody else
MOST_LOOKS = 30  # about as many are in the mean colour
FORESEEN = 15  # frames for which a lost person is moved on; it may turn after that
REACH = 0.5  # heights of the box within which a lost person is found again at once
PACE = 0.05  # heights a frame by which that grows
FARTHEST = 2.0  # heights at most
APART = 1.5  # times as far must the next one be that could be meant
DOUBT = 0.7  # share of its score that a name keeps until a reading confirms who was found again


def nowhere(*shape: int) -> Array:
    """Return zeros."""
    return np.zeros(shape, np.float32)


@dataclass(kw_only=True, eq=False)
class Person:
    """One person, as far as it is known."""

    track: int  # id of its track, or of the last one
    seq: int  # frame of the last detection
    box: Array = field(default_factory=lambda: nowhere(4))  # there, sensor pixels
    motion: Array = field(default_factory=lambda: nowhere(2))  # of its middle, pixels a frame
    lost: bool = False  # its track ended
    doubted: bool = False  # found again by its place alone
    colour: Array = field(default_factory=lambda: nowhere(3))  # of the shirt, RGB 0..255
    looks: int = 0  # that the colour is the mean of
    other: Array = field(default_factory=lambda: nowhere(3))  # colour of newest looks unlike that
    others: int = 0  # such looks in succession
    votes: dict[str, float] = field(default_factory=dict)  # text -> sum over readings
    best: dict[str, float] = field(default_factory=dict)  # text -> greatest score

    def hear(self, text: str, score: float) -> None:
        """Add a reading; one that agrees ends the doubt."""
        if self.doubted and text == self.leading(digits=text.isdigit()):
            self.doubted = False
        if text not in self.votes and len(self.votes) >= MOST_TEXTS:
            self.forget(min(self.votes, key=lambda each: self.votes[each]))
        weight = max(score - CHANCE, 0.0) / (1 - CHANCE)
        self.votes[text] = self.votes.get(text, 0.0) + weight
        self.best[text] = max(self.best.get(text, 0.0), score)
        texts = self._texts(digits=text.isdigit())
        total = sum(self.votes[each] for each in texts)
        for each in texts if total > MOST_VOTES else ():
            self.votes[each] *= MOST_VOTES / total

    def forget(self, text: str) -> None:
        """Drop all votes for a text."""
        del self.votes[text], self.best[text]

    def leading(self, *, digits: bool, least: float = 0.0) -> str:
        """Return the number, or the name, that is best supported; empty below `least` votes."""
        first = max(self._texts(digits=digits), key=self._support, default="")
        return first if first and self._support(first) >= least else ""

    def said(self, least: float) -> tuple[str, float]:
        """Return number and name with a score 0..1; an empty text where too little was read.

        The score is the best one of a reading, less the share of votes that say something else,
        and less for somebody whom only the place tells.
        """
        parts = [self.leading(digits=digits, least=least) for digits in (True, False)]
        scores = [self._score(text) for text in parts if text]
        score = min(scores, default=0.0) * (DOUBT if self.doubted else 1)
        return " ".join(text for text in parts if text), score

    def _texts(self, *, digits: bool) -> list[str]:
        return [text for text in self.votes if text.isdigit() == digits]

    def _support(self, text: str) -> float:
        """Return the votes for a text; a single digit may be one of two, seen from the side."""
        return self.votes[text] * (HALF if text.isdigit() and len(text) == 1 else 1)

    def _score(self, text: str) -> float:
        others = [t for t in self._texts(digits=text.isdigit()) if t != text and t not in text]
        against = sum(self._support(other) for other in others)
        own = self._support(text)
        return self.best[text] * own / max(own + against, 1e-9)

    def like(self, other: "Person", most: float) -> bool | None:
        """Whether the shirts have a colour within `most`; None where one was never shown."""
        if not self.looks or not other.looks:
            return None
        return bool(np.abs(self.colour - other.colour).sum() <= most)

    def show(self, colour: Array, most: float) -> None:
        """Add what the shirt looked like; what differs by more than `most` is kept apart."""
        if self.looks >= SURE_LOOKS and np.abs(colour - self.colour).sum() > most:
            self.others += 1
            self.other = (self.other + (colour - self.other) / self.others).astype(np.float32)
            return
        self.others = 0
        self.looks = min(self.looks + 1, MOST_LOOKS)
        self.colour = (self.colour + (colour - self.colour) / self.looks).astype(np.float32)

    def take_over(self, former: "Person", least: float) -> None:
        """Be a person that was lost, in doubt: a name is left no more votes than it needs."""
        self.votes, self.best = dict(former.votes), dict(former.best)
        most = max((self._support(text) for text in self.votes), default=0.0)
        for text in self.votes if most > least else ():
            self.votes[text] *= (least + EASE) / most
        if self.looks < former.looks:
            self.colour, self.looks = former.colour, former.looks
        self.doubted = bool(self.votes)


def followed(
    persons: list[Person], tracks: Tracks, *, memory: int, least: float, colour: float
) -> list[Person]:
    """Return the persons of these tracks, in their order, then those that were lost.

    A track that is new takes over a person that was lost at most `memory` frames ago and could be
    there, unless two could. Of that person `least` votes are kept. A track on which the shirt has
    changed its colour is on somebody else: its person is lost, and the track is new.
    """
    seq, known = tracks.header.seq, {each.track: each for each in persons if not each.lost}
    now = centres(tracks.boxes[:, -1])
    ahead = centres(tracks.predicted[:, 0]) if tracks.predicted.shape[1] else now
    found: list[Person] = []
    fresh: list[Person] = []
    for row, id_ in enumerate(tracks.ids.tolist()):
        each = known.get(id_)
        if each is None or each.others >= CHANGED_LOOKS:
            changed, each = each, Person(track=id_, seq=seq)
            fresh.append(each)
            if changed:
                changed.lost, each.colour, each.looks = True, changed.other, changed.others
                changed.others = 0
        if tracks.visible[row, -1] or not each.box.any():
            each.box, each.motion = tracks.boxes[row, -1].copy(), ahead[row] - now[row]
            each.seq = seq
        found.append(each)
    current = set(tracks.ids.tolist())
    for each in persons:
        each.lost = each.lost or each.track not in current
    lost = [each for each in persons if each.lost and seq - each.seq <= memory]
    for each, former in found_again(fresh, lost, seq, colour):
        each.take_over(former, least)
        lost.remove(former)
    return [*found, *sorted(lost, key=lambda each: each.seq)[-MOST_PERSONS:]]


def found_again(
    fresh: list[Person], lost: list[Person], seq: int, colour: float
) -> list[tuple[Person, Person]]:
    """Return pairs of a new person and the one that it is by its place; no person twice."""
    if not fresh or not lost:
        return []
    gaps = np.array([seq - each.seq for each in lost], np.float32)
    boxes = np.array([each.box for each in lost], np.float32)
    motion = np.array([each.motion for each in lost], np.float32)
    there = centres(boxes) + motion * np.minimum(gaps, FORESEEN)[:, None]
    here = centres(np.array([each.box for each in fresh], np.float32))
    reach = np.minimum(REACH + PACE * gaps, FARTHEST) * (boxes[:, 3] - boxes[:, 1])
    away = np.linalg.norm(here[:, None] - there[None], axis=2)
    away[away > reach[None]] = np.inf
    for i, each in enumerate(fresh):
        for j, former in enumerate(lost):
            if each.like(former, colour) is False:
                away[i, j] = np.inf
    found = []
    for i, j in (np.argwhere(np.isfinite(away))).tolist():
        others = np.concatenate([np.delete(away[i], j), np.delete(away[:, j], i)])
        if away[i, j] * APART < others.min(initial=np.inf):
            found.append((fresh[i], lost[j]))
    return found


def settled(persons: Iterable[Person], *, least: float, colour: float) -> list[Person]:
    """Return the persons after each number is left to one of those with like shirts.

    Somebody in view who was read has it rather than somebody lost, or found again by place alone;
    else who has more votes. One who is lost is the same person as the winner, and goes.
    """
    kept = list(persons)
    by_number: dict[str, list[Person]] = {}
    for each in kept:
        if number := each.leading(digits=True, least=least):
            by_number.setdefault(number, []).append(each)
    for number, alike in by_number.items():
        order = sorted(alike, key=lambda p: (p.lost, p.doubted, -p.votes[number], p.track))
        for place, each in enumerate(order):
            if any(each.like(other, colour) for other in order[:place] if number in other.votes):
                if each.lost:
                    kept.remove(each)
                else:
                    each.forget(number)
    return kept
