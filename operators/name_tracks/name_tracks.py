"""Name tracks by what was read on them, and keep the name: Tracks, Percept and ROI -> Percept.

A number on a back is readable for moments only. Each reading is a vote for the person whose box
has it; a person keeps its name while its track lives, and passes it on to the track that begins
where it was lost. A number belongs to one person of each team, told by the colour of the shirt.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from operators.name_tracks.persons import MOST_VOTES, Person, followed, settled
from pipeline import Frame, Header, Input, Operator, Percept, SettingsError, Tracks
from pipeline.boxes import boxes_at, centres, covered, intersections, parts_of
from pipeline.errors import MessageError
from pipeline.messages import Boxes, Ids, Shape
from pipeline.text import harmless

UPPER = 0.7  # share of a person's height within which a text may be
SHIRT = (0.3, 0.22, 0.7, 0.48)  # left, top, right, low: shares of a person's box
INSIDE = 0.95  # share of the shirt that the ROI must show
SHARED = 0.02  # of a shirt, hidden by another box: its colour is not taken
MOST_WAITING = 64  # answers of the reader, for tracks that are not there yet
MOST_LETTERS = 80
Array = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class NameTracksSettings:
    """What a graph may set."""

    least_score: float = 0.8  # of a reading
    votes: float = 2.0  # that agree, from which a person has a name; a sure reading is one
    # frames from the last detection of a person for which it may be found again; 0: never
    memory: int = 90
    colour: float = 110.0  # sum of differences of R, G and B up to which shirts are alike

    def __post_init__(self) -> None:
        if not 0 <= self.least_score <= 1:
            raise SettingsError(f"least_score: must be within 0..1, got {self.least_score}")
        if not 0 < self.votes <= MOST_VOTES / 2:
            raise SettingsError(f"votes: expected above 0 to 3, got {self.votes}")
        if not 0 <= self.memory <= 100_000:
            raise SettingsError(f"memory: expected 0 to 100000, got {self.memory}")
        if not 0 <= self.colour <= 765:
            raise SettingsError(f"colour: expected 0 to 765, got {self.colour}")


@dataclass(frozen=True, kw_only=True, eq=False)
class NameTracksState:
    """Everybody who is known, a row each; and a row for each vote.

    Answers of the reader that wait for the tracks of their frame are not part of it: a swap loses
    these few readings.
    """

    ids: Ids  # of the tracks
    seqs: Annotated[NDArray[np.int64], Shape.of("n")]
    boxes: Boxes
    motions: Annotated[NDArray[np.float32], Shape.of("n", 2)]
    flags: Annotated[NDArray[np.bool_], Shape.of("n", 2)]  # lost, doubted
    colours: Annotated[NDArray[np.float32], Shape.of("n", 3)]
    looks: Ids
    others: Annotated[NDArray[np.float32], Shape.of("n", 4)]  # colour of a changed shirt, its looks
    voters: Annotated[NDArray[np.int32], Shape.of("votes")]  # row of the person
    weights: Annotated[NDArray[np.float32], Shape.of("votes")]
    best: Annotated[NDArray[np.float32], Shape.of("votes")]
    texts: tuple[str, ...]  # votes
    named: int


class NameTracks(Operator[NameTracksSettings, Percept]):
    """Answers each frame with the tracks that have a name: their boxes, ids and texts.

    Without `roi` shirts have no colour, and a number may be on two tracks.
    """

    live = ("least_score", "votes", "memory", "colour")
    tracks = Input(Tracks, keep="every")
    percept = Input(Percept, join=False)  # of a reader
    roi = Input(Frame, join=False)  # for the colours of shirts

    def open(self) -> None:
        """Start with nobody."""
        self._persons: list[Person] = []
        self._tracks: Tracks | None = None
        self._waiting: list[Percept] = []
        self._readings = self._named = 0

    def on_stream(self, header: Header) -> None:
        """Forget everybody: tracks of another stream are other persons."""
        self._persons, self._tracks, self._waiting = [], None, []

    def on_percept(self, percept: Percept) -> None:
        """Keep the answer until the tracks of its frame are there."""
        if len(percept.texts) != len(percept.boxes):
            got = f"{len(percept.texts)} for {len(percept.boxes)} boxes"
            raise MessageError(f"name_tracks.percept.texts: expected one for each box, got {got}")
        if percept.texts:
            self._waiting = [*self._waiting, percept][-MOST_WAITING:]

    def on_roi(self, roi: Frame) -> None:
        """Note the colours of the shirts that it shows, where the tracks know of its frame."""
        if self._tracks is None or not roi.pixels.size or not len(self._tracks.ids):
            return
        boxes = boxes_at(self._tracks, roi.header.seq)
        if boxes is None:
            return
        by_track = {each.track: each for each in self._persons if not each.lost}
        for row, colour in shirts(boxes, roi):
            if each := by_track.get(int(self._tracks.ids[row])):
                each.show(colour, self.settings.colour)

    def on_tracks(self, tracks: Tracks) -> Percept:
        """Count what was read on these tracks up to this frame, and answer with their names."""
        s = self.settings
        self._tracks = tracks
        self._persons = followed(
            self._persons, tracks, memory=s.memory, least=s.votes, colour=s.colour
        )
        seq, waiting = tracks.header.seq, self._waiting
        self._waiting = [each for each in waiting if each.header.seq > seq]
        for percept in (each for each in waiting if each.header.seq <= seq):
            self._bind(percept, tracks)
        self._persons = settled(self._persons, least=s.votes, colour=s.colour)
        said = [each.said(s.votes) for each in self._persons[: len(tracks.ids)]]
        rows = np.array([row for row, (text, _) in enumerate(said) if text], np.intp)
        self._named = len(rows)
        return Percept(
            header=tracks.header,
            boxes=tracks.boxes[rows, -1],
            ids=tracks.ids[rows],
            scores=np.array([said[row][1] for row in rows], np.float32),
            texts=tuple(said[row][0] for row in rows),
        )

    def _bind(self, percept: Percept, tracks: Tracks) -> None:
        """Give each reading to the track that has it; the persons are in the tracks' order."""
        boxes = boxes_at(tracks, percept.header.seq)
        if boxes is None:  # nothing tells where the tracks were
            return
        owners = owners_of(percept.boxes, boxes)
        for row, text, score in zip(owners.tolist(), percept.texts, percept.scores, strict=True):
            clean = harmless(text, MOST_LETTERS).strip().upper()
            if row >= 0 and clean and score >= self.settings.least_score:
                self._persons[row].hear(clean, float(min(score, 1)))
                self._readings += 1

    def summary(self) -> Mapping[str, Any]:
        """How much was read on tracks, and how many have a name now."""
        return {"readings": self._readings, "named": self._named}

    def headline(self) -> str:
        """How many tracks have a name."""
        return f"{self._named} named"

    def state(self) -> NameTracksState:
        """Return what is known of everybody."""
        all_ = self._persons
        votes = [(row, text) for row, each in enumerate(all_) for text in each.votes]
        return NameTracksState(
            ids=np.array([each.track for each in all_], np.int32),
            seqs=np.array([each.seq for each in all_], np.int64),
            boxes=np.array([each.box for each in all_], np.float32).reshape(-1, 4),
            motions=np.array([each.motion for each in all_], np.float32).reshape(-1, 2),
            flags=np.array([(e.lost, e.doubted) for e in all_], np.bool_).reshape(-1, 2),
            colours=np.array([each.colour for each in all_], np.float32).reshape(-1, 3),
            looks=np.array([each.looks for each in all_], np.int32),
            others=np.array([[*e.other, e.others] for e in all_], np.float32).reshape(-1, 4),
            voters=np.array([row for row, _ in votes], np.int32),
            weights=np.array([all_[row].votes[text] for row, text in votes], np.float32),
            best=np.array([all_[row].best[text] for row, text in votes], np.float32),
            texts=tuple(text for _, text in votes),
            named=self._named,
        )

    def restore(self, state: NameTracksState) -> None:
        """Go on from what another instance knows."""
        self._persons = [
            Person(
                track=int(state.ids[i]), seq=int(state.seqs[i]), box=state.boxes[i].copy(),
                motion=state.motions[i].copy(), lost=bool(state.flags[i, 0]),
                doubted=bool(state.flags[i, 1]), colour=state.colours[i].copy(),
                looks=int(state.looks[i]), other=state.others[i, :3].copy(),
                others=int(state.others[i, 3]),
            )
            for i in range(len(state.ids))
        ]  # fmt: skip
        rows = zip(state.voters, state.texts, state.weights, state.best, strict=True)
        for row, text, weight, best in rows:
            each = self._persons[int(row)]
            each.votes[text], each.best[text] = float(weight), float(best)
        self._named = state.named


def owners_of(texts: Array, persons: Array) -> NDArray[np.intp]:
    """Return the row of the person (m, 4) that each text (n, 4) is on: (n,).

    It is -1 for a text that is on nobody, or where two overlap and either may wear it.

    >>> owners_of(np.array([[4, 4, 6, 6]], np.float32), np.array([[0, 0, 10, 20]], np.float32))
    array([0])
    """
    middle = centres(texts)[:, None]
    upper = persons.copy()
    upper[:, 3] = persons[:, 1] + UPPER * (persons[:, 3] - persons[:, 1])
    inside = ((middle >= upper[None, :, :2]) & (middle <= upper[None, :, 2:])).all(2)
    single = inside.sum(1) == 1
    return np.where(single, inside.argmax(1) if len(persons) else -1, -1)


def shirts(boxes: Array, roi: Frame) -> list[tuple[int, Array]]:
    """Return the rows of persons (n, 4) whose shirts a picture shows, and their mean colours."""
    if roi.pixels.ndim != 3 or roi.pixels.dtype != np.uint8:
        raise MessageError(
            f"name_tracks.roi: expected pixels of 8 bit (h, w, 3), got {roi.pixel_format} "
            f"{roi.pixels.dtype} {list(roi.pixels.shape)}"
        )
    parts = parts_of(boxes, SHIRT)
    areas = np.maximum((parts[:, 2:] - parts[:, :2]).prod(1), 1e-9)
    others = intersections(parts, boxes)
    np.fill_diagonal(others, 0)
    free = others.max(1, initial=0) <= SHARED * areas
    left, top, right, low = roi.window
    high, wide = roi.pixels.shape[:2]
    scale = np.array([wide / (right - left), high / (low - top)] * 2)
    found = []
    for row in np.flatnonzero(free & (covered(parts, np.array(roi.window, np.float32)) >= INSIDE)):
        x0, y0, x1, y1 = np.rint((parts[row] - (left, top, left, top)) * scale).astype(int)
        patch = roi.pixels[max(y0, 0) : y1, max(x0, 0) : x1]
        if patch.size:
            found.append((int(row), patch.reshape(-1, 3).mean(0, dtype=np.float32)))
    return found
