"""Identities of tracks by what the ROI showed: kept, found again, exchanged, never reused."""

import numpy as np
import pytest

from operators.identity import Identity, IdentitySettings
from pipeline import RoiFeatures, SettingsError, Tracks
from pipeline.codec import dumps, loads
from pipeline.testing import header

SIZE_PX = 40.0
NAMES = ("player", "ball")
Place = tuple[int, float, float]  # track id, x, y of the centre
RED, BLUE, GREEN = (np.eye(3, dtype=np.float32)[k] for k in range(3))


def tracks(seq: int, *places: Place, unseen: tuple[int, ...] = ()) -> Tracks:
    ids = np.array([i for i, _, _ in places], np.int32)
    centre = np.array([(x, y) for _, x, y in places], np.float32).reshape(-1, 2)
    boxes = np.concatenate([centre - SIZE_PX / 2, centre + SIZE_PX / 2], axis=1)[:, None]
    return Tracks(
        header=header(seq),
        ids=ids,
        labels=np.zeros(len(ids), np.int32),
        scores=np.ones(len(ids), np.float32),
        boxes=boxes,
        visible=~np.isin(ids, unseen)[:, None],
        features=np.zeros((len(ids), 1, 0), np.float32),
        predicted=boxes,
        names=NAMES,
    )


def looks(seq: int, **colours: np.ndarray) -> RoiFeatures:
    """Return what the ROI showed of tracks `t1`, `t2`, …"""
    ids = np.array([int(name[1:]) for name in colours], np.int32)
    features = np.array(list(colours.values()), np.float32).reshape(len(ids), -1)
    return RoiFeatures(
        header=header(seq), ids=ids, features=features, genuine=np.ones(len(ids), np.float32)
    )


class Match:
    """Frames one after the other, to one operator; `ids` are the last answer's, by place."""

    def __init__(self, **settings: float) -> None:
        self.operator = Identity(IdentitySettings(**settings))  # type: ignore[arg-type]
        self.operator.open()
        self.seq = 0

    def play(
        self, frames: int, *places: Place, unseen: tuple[int, ...] = (), **colours: np.ndarray
    ) -> list[int]:
        """Return the identities of `places` after these frames."""
        for _ in range(frames):
            found = self.operator.on_tracks(tracks(self.seq, *places, unseen=unseen))
            if colours:
                self.operator.on_features(looks(self.seq, **colours))
            self.seq += 1
        order = {tuple(b): int(i) for i, b in zip(found.ids, found.boxes[:, -1], strict=True)}
        return [order[tuple(b)] for b in tracks(0, *places).boxes[:, -1]]


def test_a_track_that_is_never_shown_keeps_its_identity_by_motion() -> None:
    match = Match()

    first = match.play(5, (1, 100, 100), (2, 300, 100))
    later = match.play(20, (1, 150, 100), (2, 350, 100))

    assert first == later
    assert len(set(later)) == 2


def test_a_new_track_that_looks_like_a_lost_one_gets_its_identity() -> None:
    match = Match()
    one, other = match.play(10, (1, 100, 100), (2, 300, 100), t1=RED, t2=BLUE)
    match.play(5, (2, 300, 100))

    before = match.play(1, (7, 110, 100), (2, 300, 100))[0]
    match.play(4, (7, 110, 100), (2, 300, 100), t7=RED)

    assert before not in (one, other)  # nobody has looked yet
    assert match.play(1, (7, 110, 100), (2, 300, 100)) == [one, other]


def test_a_new_track_that_looks_different_is_somebody_new() -> None:
    match = Match()
    (one,) = match.play(10, (1, 100, 100), t1=RED)
    match.play(5)

    (found,) = match.play(20, (7, 110, 100), t7=BLUE)

    assert found != one


def test_nobody_comes_back_faster_than_an_object_can_move() -> None:
    match = Match(speed=0.5)
    (one,) = match.play(10, (1, 100, 100), t1=RED)
    match.play(3)

    (far,) = match.play(20, (7, 1500, 100), t7=RED)

    assert far != one


def test_nobody_comes_back_after_the_memory_is_over() -> None:
    match = Match(memory=10)
    (one,) = match.play(10, (1, 100, 100), t1=RED)
    match.play(30)

    (late,) = match.play(20, (7, 110, 100), t7=RED)

    assert late != one


def test_tracks_that_exchange_their_objects_in_a_crossing_exchange_identities() -> None:
    match = Match()
    one, other = match.play(10, (1, 100, 100), (2, 300, 100), t1=RED, t2=BLUE)
    match.play(3, (1, 200, 100), (2, 210, 100))

    match.play(6, (1, 300, 100), (2, 100, 100), t1=BLUE, t2=RED)

    assert match.play(1, (1, 300, 100), (2, 100, 100)) == [other, one]


def test_one_look_after_a_crossing_settles_both_who_crossed() -> None:
    match = Match()
    one, other = match.play(10, (1, 100, 100), (2, 300, 100), t1=RED, t2=BLUE)
    match.play(3, (1, 200, 100), (2, 210, 100))

    match.play(6, (1, 300, 100), (2, 100, 100), t1=BLUE)

    assert match.play(1, (1, 300, 100), (2, 100, 100)) == [other, one]


def test_of_three_that_crossed_two_looks_settle_all() -> None:
    match = Match()
    apart = ((1, 100, 100), (2, 300, 100), (3, 500, 100))
    one, two, three = match.play(10, *apart, t1=RED, t2=BLUE, t3=GREEN)
    match.play(3, (1, 200, 100), (2, 205, 100), (3, 210, 100))

    match.play(6, *apart, t1=BLUE, t2=GREEN)

    assert match.play(1, *apart) == [two, three, one]


def test_a_track_that_was_not_reported_for_a_while_keeps_its_identity() -> None:
    match = Match()
    before = match.play(3, (1, 100, 100), (2, 300, 100))
    match.play(20, (1, 100, 100))

    assert match.play(3, (1, 100, 100), (2, 300, 100)) == before


def test_tracks_that_cross_and_look_as_before_keep_their_identities() -> None:
    match = Match()
    before = match.play(10, (1, 100, 100), (2, 300, 100), t1=RED, t2=BLUE)
    match.play(3, (1, 200, 100), (2, 210, 100))

    assert match.play(10, (1, 300, 100), (2, 100, 100), t1=RED, t2=BLUE) == before


def test_what_the_roi_shows_of_two_that_overlap_is_not_remembered() -> None:
    match = Match()
    before = match.play(10, (1, 100, 100), (2, 300, 100), t1=RED, t2=BLUE)
    match.play(10, (1, 200, 100), (2, 210, 100), t1=BLUE, t2=RED)  # the other one is in front

    assert match.play(10, (1, 300, 100), (2, 100, 100), t1=RED, t2=BLUE) == before


def test_a_track_found_again_on_another_object_leaves_its_identity_behind() -> None:
    match = Match()
    one, other = match.play(10, (1, 100, 100), (2, 140, 100), t1=RED, t2=BLUE)
    match.play(6, (1, 100, 100), unseen=(1,))  # both hidden; 2 has ended

    (found,) = match.play(6, (1, 130, 100), t1=BLUE)

    assert found == other != one


def test_identities_are_never_reused() -> None:
    match = Match(memory=0)
    seen = [match.play(2, (track, 100, 100), t1=RED)[0] for track in range(1, 30)]

    assert len(set(seen)) == len(seen)


def test_the_lost_that_are_remembered_are_limited() -> None:
    match = Match(most_lost=5, likeness=1.0, speed=0.0)
    for track in range(1, 40):
        match.play(5, (track, 50.0 * track, 100), **{f"t{track}": RED})

    assert len(match.operator.state().ids) <= 6


def test_another_stream_begins_without_identities() -> None:
    match = Match()
    match.play(10, (1, 100, 100), t1=RED)

    match.operator.on_stream(header(0))

    assert not len(match.operator.state().ids)


def test_a_successor_continues_with_the_same_identities() -> None:
    match, successor = Match(), Match()
    match.play(10, (1, 100, 100), (2, 300, 100), t1=RED, t2=BLUE)
    before = match.play(3, (1, 200, 100), (2, 210, 100))

    state = match.operator.state()
    successor.operator.restore(loads(type(state), dumps(state)))
    successor.seq = match.seq
    successor.play(6, (1, 300, 100), (2, 100, 100), t1=BLUE, t2=RED)

    assert successor.play(1, (1, 300, 100), (2, 100, 100)) == before[::-1]


def test_an_encoder_of_another_width_begins_with_new_appearances() -> None:
    match = Match()
    before = match.play(10, (1, 100, 100), t1=RED)

    assert match.play(10, (1, 100, 100), t1=np.ones(5, np.float32)) == before


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_features_that_are_no_numbers_are_no_look(wrong: float) -> None:
    match = Match()
    first = match.play(5, (1, 100, 100), t1=RED)

    match.play(1, (1, 100, 100), t1=np.full(3, wrong, np.float32))
    match.play(5, (1, 100, 100), unseen=(1,))

    assert match.play(5, (1, 100, 100), t1=RED) == first


def test_the_answer_is_ordered_by_identity() -> None:
    match = Match()
    match.play(3, (5, 100, 100), (2, 300, 100))

    found = match.operator.on_tracks(tracks(3, (2, 300, 100), (5, 100, 100), (9, 500, 100)))

    assert list(found.ids) == sorted(found.ids)
    assert len(found.ids) == 3


@pytest.mark.parametrize(
    "setting", [{"looks": 0}, {"likeness": 2.0}, {"overlap": 0.0}, {"memory": -1}]
)
def test_settings_out_of_range_are_refused(setting: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match=next(iter(setting))):
        IdentitySettings(**setting)  # type: ignore[arg-type]
