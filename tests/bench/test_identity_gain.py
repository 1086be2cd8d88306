"""What a look gains the identities: kinds of looks, and what is lost without each."""

from dataclasses import replace

import numpy as np
import pytest

from bench.identity_gain import (
    KINDS,
    Looks,
    correlation_of,
    drawn,
    kinds_of,
    measured,
    outcome_of,
    rows_of,
    shares_of,
)
from bench.tracking.clip import Clip, ClipName
from drivers.source import Annotations
from operators.identity import IdentitySettings
from operators.identity.people import nobody, seen
from pipeline.errors import SettingsError
from pipeline.messages import RoiFeatures, Tracks
from pipeline.testing import header

PATHS = np.array([[100, 100, 140, 200], [400, 100, 440, 200]], np.float32)
FRAMES, GAP = 60, range(25, 35)  # both tracks end in the gap and begin again under other ids


def tracks_of(frame: int) -> Tracks:
    rows = 0 if frame in GAP else 2
    first = 1 if frame < GAP.start else 3
    return Tracks(
        header=replace(header(), seq=frame),
        ids=np.arange(first, first + rows, dtype=np.int32),
        labels=np.zeros(rows, np.int32),
        scores=np.ones(rows, np.float32),
        boxes=PATHS[:rows, None].copy(),
        visible=np.ones((rows, 1), np.bool_),
        features=np.zeros((rows, 1, 4), np.float32),
        predicted=np.repeat(PATHS[:rows, None], 2, axis=1),
        names=("player",),
    )


def clip_of_two() -> Looks:
    """Two people who are unlike each other, and looks at both in every frame."""
    tracks = {frame: tracks_of(frame) for frame in range(FRAMES)}
    truth = Annotations(
        boxes=PATHS, ids=np.array([7, 8], np.int32), labels=("player", "player"),
        visibility=np.ones(2, np.float32),
    )  # fmt: skip
    features = {
        frame: RoiFeatures(
            header=each.header, ids=each.ids, features=np.eye(2, dtype=np.float32)[: len(each.ids)],
            genuine=np.ones(len(each.ids), np.float32),
        )
        for frame, each in tracks.items()
    }  # fmt: skip
    return Looks(
        clip=Clip(name=ClipName(seed=0), size_px=(640, 480), pictures=(), truths=[truth] * FRAMES),
        tracks=tracks,
        features=features,
        shown={frame: np.ones(len(each.ids), np.bool_) for frame, each in tracks.items()},
        identity=IdentitySettings(),
    )


def test_looks_join_interrupted_tracks_and_those_in_doubt_are_what_gains() -> None:
    pytest.importorskip("trackeval")
    found = measured(clip_of_two())

    assert found["all"] > found["none"] + 0.1
    lost = dict(zip(KINDS, found["lost"], strict=True))
    assert lost.pop("in doubt, a look that decides") > 0
    assert lost.pop("in doubt, a later look") >= 0
    assert max(np.abs(list(lost.values()))) == pytest.approx(0)


def test_only_looks_that_were_of_a_kind_are_left_out() -> None:
    pytest.importorskip("trackeval")
    whole = clip_of_two()
    kinds = outcome_of(whole).kinds
    without = replace(whole, shown={k: whole.shown[k] & (kinds[k] != 1) for k in whole.shown})

    given = sum(int(mask.sum()) for mask in whole.shown.values())
    assert outcome_of(whole).counts.sum() == given
    assert outcome_of(without).counts.sum() == given - outcome_of(whole).counts[1]


def test_without_looks_nothing_is_counted() -> None:
    pytest.importorskip("trackeval")
    whole = clip_of_two()
    found = outcome_of(replace(whole, shown={k: ~mask for k, mask in whole.shown.items()}))

    assert found.counts.sum() == 0
    assert found.stand_in.sum() == 0


def test_the_kind_of_a_look_is_what_identity_knows_before_it() -> None:
    people = seen(nobody(4), tracks_of(0), coasted=2, overlap=0.3)
    rows, ages = np.array([0, 1]), np.array([3, 40])
    sure = replace(people, doubtful=np.zeros(2, np.bool_))
    late = replace(people, fresh_looks=np.full(2, 3, np.float32))
    mixed = replace(people, mixed=np.array([True, False]))

    assert list(kinds_of(people, rows, ages, 3)) == [1, 1]
    assert list(kinds_of(late, rows, ages, 3)) == [2, 2]
    assert list(kinds_of(sure, rows, ages, 3)) == [3, 5]
    assert list(kinds_of(mixed, rows, ages, 3)) == [0, 1]


def test_a_share_of_the_looks_is_drawn_by_the_seed() -> None:
    whole = clip_of_two()
    few, again, others = (drawn(whole, 0.2, seed) for seed in (1, 1, 2))
    counts = [sum(int(mask.sum()) for mask in each.shown.values()) for each in (few, whole)]

    assert 0 < counts[0] < 0.5 * counts[1]
    assert all((few.shown[k] == again.shown[k]).all() for k in few.shown)
    assert any((few.shown[k] != others.shown[k]).any() for k in few.shown)


def test_rows_have_every_kind_and_no_correlation_where_nothing_is_gained() -> None:
    pytest.importorskip("trackeval")
    rows = rows_of([measured(clip_of_two())] * 2)
    nothing = [row | {"by 1,000": 0.0} for row in rows]

    assert [row["look"] for row in rows] == list(KINDS)
    assert correlation_of(rows) is not None
    assert correlation_of(nothing) is None


@pytest.mark.parametrize("given", ["", "0", "1.5", "x", "nan", "0.1,,0.2"])
def test_a_wrong_share_is_refused(given: str) -> None:
    with pytest.raises(SettingsError, match="--shares: expected numbers above 0 to 1"):
        shares_of(given)
