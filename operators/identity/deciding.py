"""Decide who the ROI has shown: the table of identities -> the same with tracks reassigned."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from operators.identity.people import (
    NONE,
    Bools,
    Floats,
    Numbers,
    People,
    merged,
    units,
)
from pipeline.boxes import centres, sizes

NEVER = -1e6  # value of a pair that is not allowed
OF_TRACK = ("tracks", "lost", "labels", "boxes", "seen_seq", "doubtful", "doubt_seq", "mixed")
OF_LOOKS = ("fresh", "fresh_looks")


@dataclass(frozen=True, kw_only=True)
class Rules:
    """When a track is who; see `IdentitySettings`."""

    looks: int
    likeness: float
    margin: float
    speed: float
    memory: int
    patience: int


def decided(people: People, rules: Rules) -> People:
    """Return the table after comparing tracks in doubt that the ROI has shown often enough.

    A track may keep its identity, take a lost one that could have come this far, or exchange it
    with a track that it overlapped and that is still in doubt.
    """
    enough = people.fresh_looks >= rules.looks
    rows = np.flatnonzero(~people.lost & people.doubtful & ~people.mixed & enough)
    if not len(rows):
        return people
    value = values(people, rows, rules)
    _, owner = linear_sum_assignment(value, maximize=True)
    own = owner == rows
    unknown = (people.known_looks[rows] == 0) & (people.fresh_looks[rows] < rules.patience)
    people = exchanged(people, rows[~own], owner[~own])
    return merged(people, np.concatenate([rows[own & ~unknown], owner[~own]]))


def values(people: People, rows: Numbers, rules: Rules) -> Floats:
    """Return the value of each identity (n) for some rows (r): (r, n), `NEVER` if impossible.

    It is the likeness of looks, -1 to 1. A row's own identity has a margin before the others; one
    that was not known before is worth the least likeness.
    """
    likeness = units(people.fresh[rows]) @ units(people.known).T
    allowed = people.known_looks[None] > 0
    allowed = allowed & (back(people, rows, rules) | confused(people, rows))
    value = np.where(allowed & (likeness >= rules.likeness), likeness, NEVER)
    at = np.arange(len(rows))
    held = np.where(people.known_looks[rows] > 0, likeness[at, rows] + rules.margin, rules.likeness)
    value[at, rows] = held
    return np.asarray(value, np.float32)


def back(people: People, rows: Numbers, rules: Rules) -> Bools:
    """Return which lost identities (n) could have come to the place of which rows (r): (r, n)."""
    gone = people.seq - people.seen_seq
    away = np.linalg.norm(
        centres(people.boxes[rows])[:, None] - centres(people.boxes)[None], axis=2
    )
    reach = (1 + rules.speed * gone) * sizes(people.boxes)
    before = people.seen_seq[None] <= people.doubt_seq[rows][:, None]
    alike = people.labels[None] == people.labels[rows][:, None]
    lost = people.lost & (gone <= rules.memory)
    return np.asarray(lost[None] & before & alike & (away <= reach[None]))


def confused(people: People, rows: Numbers) -> Bools:
    """Return which identities (n) on a track in doubt overlapped which rows (r): (r, n)."""
    return np.asarray(people.rivals[rows] & (~people.lost & people.doubtful)[None])


def exchanged(people: People, rows: Numbers, owners: Numbers) -> People:
    """Return the table in which the tracks of `rows` belong to the identities in `owners`.

    A track that loses its identity to another gets that one's former identity; an identity that
    is left without a track is lost, and is removed if nothing is known of it.
    """
    if not len(rows):
        return people
    source = np.full(len(people.ids), -1)  # the row whose track an identity gets
    source[owners] = rows
    displaced = np.setdiff1d(owners[~people.lost[owners]], rows)
    for row in displaced:
        free = int(row)
        # exchanges form chains (1 takes 2's track, 2 takes 3's): the identity at the end is free
        while source[free] >= 0:
            free = int(source[free])
        source[free] = row
    moved = np.flatnonzero(source >= 0)
    freed = np.setdiff1d(np.concatenate([rows, displaced]), moved)
    changed = {name: getattr(people, name).copy() for name in (*OF_TRACK, *OF_LOOKS)}
    for name, column in changed.items():
        column[moved] = getattr(people, name)[source[moved]]
    changed["tracks"][freed], changed["lost"][freed] = NONE, True
    changed["seen_seq"][freed] = people.doubt_seq[freed]
    for name in ("doubtful", "mixed", *OF_LOOKS):
        changed[name][freed] = 0
    rivals = people.rivals.copy()
    rivals[moved] = False
    return replace(people, rivals=rivals, **changed)
