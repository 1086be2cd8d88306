"""Identities as one table: a row per identity, on a track or lost.

Every function takes a table and returns a new one, so that the table is also the state that
survives a swap. An identity is *doubtful* from the moment in which its track may have passed to
another object (it began, coasted, or overlapped another one) until the ROI has shown who it is.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline import Tracks
from pipeline.boxes import iou

NONE = -1  # in place of a track
Bools = NDArray[np.bool_]
Numbers = NDArray[np.int64]
Floats = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class People:
    """All identities at frame `seq`; n may be 0. Objects of any class, in spite of the name."""

    seq: int
    next_id: int
    ids: Numbers  # (n,), identities
    tracks: Numbers  # (n,), id of the track that it is on or was on last, or NONE
    lost: Bools  # (n,): its track is not reported, or not its own any more
    labels: Numbers  # (n,)
    boxes: Floats  # (n, 4), of the last detection, sensor pixels
    seen_seq: Numbers  # (n,), of the last detection
    doubtful: Bools  # (n,)
    doubt_seq: Numbers  # (n,), when the doubt began
    mixed: Bools  # (n,): it overlaps another one now, and the ROI would show both
    known: Floats  # (n, d): sum of looks of length 1 that are certainly its own
    known_looks: Floats  # (n,)
    fresh: Floats  # (n, d): sum of looks since the doubt began
    fresh_looks: Floats  # (n,)
    rivals: Bools  # (n, n): it overlapped this one during its doubt

    def rows_of(self, tracks: NDArray[np.int32]) -> Numbers:
        """Return the row of each track (m,); -1 for an unknown one."""
        place = {int(track): row for row, track in enumerate(self.tracks) if track != NONE}
        return np.array([place.get(int(track), -1) for track in tracks], np.int64)


ROWS = tuple(
    name for name in People.__dataclass_fields__ if name not in ("seq", "next_id", "rivals")
)


def nobody(channels: int = 0, next_id: int = 1) -> People:
    """Return a table without identities."""
    whole, yes = np.zeros(0, np.int64), np.zeros(0, np.bool_)
    looks, number = np.zeros((0, channels), np.float32), np.zeros(0, np.float32)
    return People(
        seq=-1, next_id=next_id, ids=whole, tracks=whole, lost=yes, labels=whole,
        boxes=np.zeros((0, 4), np.float32), seen_seq=whole, doubtful=yes, doubt_seq=whole,
        mixed=yes, known=looks, known_looks=number, fresh=looks, fresh_looks=number,
        rivals=np.zeros((0, 0), np.bool_),
    )  # fmt: skip


def select(people: People, rows: Numbers | Bools) -> People:
    """Return the table with these rows only."""
    kept = {name: getattr(people, name)[rows] for name in ROWS}
    return replace(people, rivals=people.rivals[rows][:, rows], **kept)


def seen(people: People, tracks: Tracks, *, coasted: int, overlap: float) -> People:
    """Return the table with the tracks of a frame: ended, found again, begun, and overlapping."""
    people = replace(people, seq=tracks.header.seq)
    people = ended(people, tracks)
    people = found(people, tracks, coasted)
    people = begun(people, tracks)
    return overlapping(people, tracks, overlap)


def ended(people: People, tracks: Tracks) -> People:
    """Return the table in which identities of tracks that are no more are lost.

    What was not known before the doubt takes the looks since then for its own.
    """
    gone = ~people.lost & ~np.isin(people.tracks, tracks.ids)
    people = merged(people, np.flatnonzero(gone & (people.known_looks == 0)))
    return replace(people, lost=people.lost | gone, mixed=people.mixed & ~gone)


def found(people: People, tracks: Tracks, coasted: int) -> People:
    """Return the table with the boxes of known tracks; those that coasted for long are in doubt.

    So is a track that was not reported for a while.
    """
    rows = people.rows_of(tracks.ids)
    own = np.flatnonzero((rows >= 0) & tracks.visible[:, -1])
    at = rows[own]
    long = at[people.seq - people.seen_seq[at] > coasted]
    boxes, seen_seq, labels = people.boxes.copy(), people.seen_seq.copy(), people.labels.copy()
    lost = people.lost.copy()
    lost[rows[rows >= 0]] = False
    people = doubted(people, long)
    boxes[at], seen_seq[at], labels[at] = tracks.boxes[own, -1], people.seq, tracks.labels[own]
    return replace(people, boxes=boxes, seen_seq=seen_seq, labels=labels, lost=lost)


def begun(people: People, tracks: Tracks) -> People:
    """Return the table with an identity of its own for each new track, in doubt."""
    new = np.flatnonzero(people.rows_of(tracks.ids) < 0)
    count, channels = len(new), people.known.shape[1]
    number, looks = np.zeros(count, np.float32), np.zeros((count, channels), np.float32)
    rows: dict[str, Any] = {
        "ids": np.arange(people.next_id, people.next_id + count),
        "tracks": tracks.ids[new],
        "lost": np.zeros(count, np.bool_),
        "labels": tracks.labels[new],
        "boxes": tracks.boxes[new, -1],
        "seen_seq": np.full(count, people.seq),
        "doubtful": np.ones(count, np.bool_),
        "doubt_seq": np.full(count, people.seq),
        "mixed": np.zeros(count, np.bool_),
        "known": looks,
        "known_looks": number,
        "fresh": looks,
        "fresh_looks": number,
    }
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(people, name), rows[name]]) for name in ROWS
    }
    rivals = np.pad(people.rivals, (0, count))
    return replace(people, next_id=people.next_id + count, rivals=rivals, **joined)


def overlapping(people: People, tracks: Tracks, overlap: float) -> People:
    """Return the table in which tracks that overlap are in doubt, and rivals of each other."""
    rows = people.rows_of(tracks.ids)
    shared = iou(tracks.boxes[:, -1], tracks.boxes[:, -1]) >= overlap
    np.fill_diagonal(shared, val=False)
    one, other = np.nonzero(shared)
    rivals, mixed = people.rivals.copy(), np.zeros(len(people.ids), np.bool_)
    mixed[rows[one]] = True
    people = doubted(people, np.flatnonzero(mixed))
    rivals[rows[one], rows[other]] = True
    return replace(people, rivals=rivals, mixed=mixed)


def doubted(people: People, rows: Numbers) -> People:
    """Return the table in which these rows are in doubt from now on, or still, without looks.

    What was in doubt before stays so for the same reason; nothing that it was is forgotten.
    """
    sure = rows[~people.doubtful[rows]]
    doubtful, doubt_seq = people.doubtful.copy(), people.doubt_seq.copy()
    fresh, looks = people.fresh.copy(), people.fresh_looks.copy()
    doubtful[sure], doubt_seq[sure] = True, people.seen_seq[sure]
    fresh[rows], looks[rows] = 0, 0
    return replace(people, doubtful=doubtful, doubt_seq=doubt_seq, fresh=fresh, fresh_looks=looks)


def merged(people: People, rows: Numbers) -> People:
    """Return the table in which the looks since the doubt count as known, and the doubt is over."""
    known, looks = people.known.copy(), people.known_looks.copy()
    fresh, fresh_looks = people.fresh.copy(), people.fresh_looks.copy()
    doubtful, rivals = people.doubtful.copy(), people.rivals.copy()
    known[rows] += fresh[rows]
    looks[rows] += fresh_looks[rows]
    fresh[rows], fresh_looks[rows], doubtful[rows], rivals[rows] = 0, 0, False, False
    return replace(
        people, known=known, known_looks=looks, fresh=fresh, fresh_looks=fresh_looks,
        doubtful=doubtful, rivals=rivals,
    )  # fmt: skip


def looked(people: People, tracks: NDArray[np.int32], features: Floats, most: int) -> People:
    """Add a look at each of these tracks (m,), features (m, d); none where two overlap.

    Features that are no finite numbers are no look: in a mean they would stay for ever.
    Of what is known, a mean over about `most` looks is kept. Where d changes, the appearance of
    everybody is forgotten.
    """
    if features.shape[1] != people.known.shape[1]:
        blank = np.zeros((len(people.ids), features.shape[1]), np.float32)
        none = np.zeros(len(people.ids), np.float32)
        people = replace(people, known=blank, known_looks=none, fresh=blank, fresh_looks=none)
    rows = people.rows_of(tracks)
    own = np.flatnonzero((rows >= 0) & np.isfinite(features).all(axis=1))
    own = own[~people.mixed[rows[own]]]
    at, looks = rows[own], units(features[own])
    known, known_looks = people.known.copy(), people.known_looks.copy()
    fresh, fresh_looks = people.fresh.copy(), people.fresh_looks.copy()
    new = people.doubtful[at]
    fresh[at[new]] += looks[new]
    fresh_looks[at[new]] += 1
    known[at[~new]] += looks[~new]
    known_looks[at[~new]] += 1
    keep = np.minimum(most / np.maximum(known_looks, 1), 1).astype(np.float32)
    return replace(
        people, known=known * keep[:, None], known_looks=known_looks * keep,
        fresh=fresh, fresh_looks=fresh_looks,
    )  # fmt: skip


def units(vectors: Floats) -> Floats:
    """Return vectors (n, d) of length 1; zero where they are zero."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, 1e-9), np.float32)


def remembered(people: People, memory: int, most: int) -> People:
    """Return the table without identities that were lost long ago, and at most `most` lost ones.

    Those that the ROI never showed go first.
    """
    lost, shown = people.lost, people.known_looks > 0
    kept = ~lost | (people.seq - people.seen_seq <= memory) & (shown | (people.tracks != NONE))
    rows = np.flatnonzero(kept & lost)
    order = np.lexsort((-people.seen_seq[rows], ~shown[rows]))
    kept[rows[order[most:]]] = False
    return people if kept.all() else select(people, kept)
