"""Detections -> Tracks: identity, gaps, prediction, beginning and end."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from operators.association import Association, AssociationSettings
from pipeline import Detections, MessageError, SettingsError, Tracks
from pipeline.codec import dumps, loads
from pipeline.testing import drive, header


def seen(seq: int, *objects: tuple[float, float, float, int], score: float = 0.9) -> Detections:
    """Return detections of squares (centre x, centre y, side, label) in frame `seq`."""
    rows = np.array(objects, np.float32).reshape(-1, 4)
    half = rows[:, 2:3] / 2
    return Detections(
        header=header(seq),
        boxes=np.concatenate([rows[:, :2] - half, rows[:, :2] + half], axis=1),
        angles=np.zeros(len(rows), np.float32),
        scores=np.full(len(rows), score, np.float32),
        labels=rows[:, 3].astype(np.int32),
        features=np.repeat(rows[:, :1], 3, axis=1),  # three channels, each the centre's x
        names=("ball", "player"),
    )


def follow(*frames: Detections, **values: object) -> list[Tracks]:
    return drive(Association, frames, values)


def test_an_object_is_reported_when_it_has_been_seen_twice():
    first, second = follow(seen(0, (100, 100, 40, 1)), seen(1, (102, 100, 40, 1)))

    assert len(first.ids) == 0
    assert second.ids.tolist() == [1]
    assert second.names == ("ball", "player")


def test_an_object_keeps_its_id_and_its_future_follows_its_speed():
    tracks = follow(*[seen(k, (100 + 5 * k, 200, 40, 1)) for k in range(20)])

    last = tracks[-1]
    assert last.ids.tolist() == [1]
    np.testing.assert_allclose(last.predicted[0, 15], [255, 180, 295, 220], atol=1.0)
    assert last.predicted.shape == (1, 16, 4)


@pytest.mark.parametrize(("times", "ids"), [(2, [1]), (1, [])])
def test_an_object_that_was_reported_once_is_kept_longer_than_another(times: int, ids: list[int]):
    square, back = (100, 100, 40, 1), times + 4
    frames = [seen(k, square) if k < times or k == back else seen(k) for k in range(back + 1)]

    tracks = follow(*frames, confirm=2, max_missed=5, max_missed_unconfirmed=1)

    assert tracks[-1].ids.tolist() == ids  # of one that had ended it is a first sight


def test_history_holds_what_was_detected():
    last = follow(*[seen(k, (100 + 5 * k, 200, 40, 1)) for k in range(6)])[-1]

    assert last.boxes[0, :, 0].tolist() == [90, 95, 100, 105]
    assert last.visible.all()
    assert last.features[0, :, 0].tolist() == [110, 115, 120, 125]


def test_a_frame_without_the_object_is_filled_by_the_filter():
    frames = [seen(k, (100 + 5 * k, 200, 40, 1)) for k in range(8)]
    frames[6] = seen(6)

    last = follow(*frames)[-1]

    assert last.visible.tolist() == [[True, True, False, True]]
    np.testing.assert_allclose(last.boxes[0, 2], [110, 180, 150, 220], atol=1.0)
    assert last.features[0, 2, 0] == 125


def test_the_time_step_is_the_difference_of_seqs():
    told = [k for k in range(20) if k not in (7, 8, 13)]

    last = follow(*[seen(k, (100 + 5 * k, 200, 40, 1)) for k in told])[-1]
    at_14 = follow(*[seen(k, (100 + 5 * k, 200, 40, 1)) for k in told if k < 15])[-1]

    assert last.ids.tolist() == [1]
    np.testing.assert_allclose(last.predicted[0, 0], [180, 180, 220, 220], atol=0.5)
    assert at_14.visible.tolist() == [[True, True, False, True]]


def test_a_fast_ball_keeps_its_id_where_boxes_never_overlap():
    frames = [seen(k, (100 + 18 * k, 300, 16, 0)) for k in range(10)]

    assert follow(*frames)[-1].ids.tolist() == [1]
    assert len(follow(*frames, small_reach=0.0)[-1].ids) == 0


def test_an_object_ends_when_it_is_missed_in_more_frames_than_allowed():
    frames = [seen(k, (100, 100, 40, 1)) for k in range(3)] + [seen(k) for k in range(3, 9)]

    counts = [len(t.ids) for t in follow(*frames, max_missed=3)]

    assert counts == [0, 1, 1, 1, 1, 1, 0, 0, 0]


def test_a_long_gap_ends_all_objects_and_no_id_is_reused():
    frames = [seen(k, (100, 100, 40, 1)) for k in (0, 1, 1000, 1001)]

    tracks = follow(*frames)

    assert [t.ids.tolist() for t in tracks] == [[], [1], [], [2]]


def test_an_unseen_object_that_left_the_field_ends_at_once():
    frames = [seen(k, (1900 + 8 * k, 500, 40, 1)) for k in range(3)]

    tracks = follow(*frames, seen(3))

    assert len(tracks[2].ids) == 1
    assert len(tracks[3].ids) == 0


def test_an_object_changes_its_class_after_three_detections_of_another_and_not_after_one():
    labels = [1, 1, 0, 1, 0, 0, 0]

    tracks = follow(*[seen(k, (100, 100, 60, label)) for k, label in enumerate(labels)])

    assert [t.labels.tolist() for t in tracks[1:]] == [[1], [1], [1], [1], [1], [0]]


def test_the_ball_is_not_pushed_out_by_many_players():
    players = [(60.0 * i, 500, 40, 1) for i in range(1, 30)]
    frames = []
    for k in range(3):
        frame = seen(k, *players, (300, 900, 16, 0))
        frame.scores[-1] = 0.1
        frames.append(frame)

    last = follow(*frames)[-1]

    assert len(last.ids) == 25
    assert (last.labels == 0).sum() == 1
    assert (np.diff(last.ids) > 0).all()


def test_a_new_stream_discards_the_objects_of_the_old_one():
    subject = Association(AssociationSettings())
    subject.open()
    subject.on_detections(seen(5, (100, 100, 40, 1)))

    subject.on_stream(header(0, stream="other"))
    subject.on_detections(seen(0, (100, 100, 40, 1)))
    tracks = subject.on_detections(seen(1, (100, 100, 40, 1)))

    assert tracks.ids.tolist() == [1]


def test_the_command_forget_discards_all_objects_and_their_ids_are_not_reused():
    operator = Association(AssociationSettings(confirm=1))
    operator.open()
    before = [operator.on_detections(seen(k, (100, 100, 20, 0))) for k in range(3)][-1]

    assert operator.do_forget() == {"forgotten": 1}
    after = operator.on_detections(seen(3, (100, 100, 20, 0)))

    assert before.ids.tolist() != after.ids.tolist()
    assert len(after.ids) == 1


def wide(frame: Detections, channels: int) -> Detections:
    return replace(frame, features=np.ones((len(frame.boxes), channels), np.float32))


@pytest.mark.parametrize("before", ["forgotten", "all objects ended", "an empty picture"])
def test_another_detector_may_follow_where_no_object_is_left(before: str):
    operator = Association(AssociationSettings(confirm=1, max_missed=2))
    operator.open()
    if before == "an empty picture":
        operator.on_detections(wide(seen(0), 0))
    else:
        for k in range(2):
            operator.on_detections(wide(seen(k, (100, 100, 20, 0)), 64))
    if before == "forgotten":
        operator.do_forget()
    elif before == "all objects ended":
        for k in range(2, 8):
            operator.on_detections(wide(seen(k), 64))

    after = operator.on_detections(wide(seen(8, (100, 100, 20, 0)), 96))

    assert after.features.shape[2] == 96
    assert len(after.ids) == 1


def test_a_successor_with_the_state_continues_as_its_predecessor_would():
    frames = [seen(k, (100 + 7 * k, 200, 30, 1), (900 - 9 * k, 400, 16, 0)) for k in range(12)]
    old, successor = Association(AssociationSettings()), Association(AssociationSettings())
    old.open()
    successor.open()
    for frame in frames[:6]:
        old.on_detections(frame)

    state = loads(type(old.state()), dumps(old.state()))
    successor.restore(state)

    for frame in frames[6:]:
        assert dumps(successor.on_detections(frame)) == dumps(old.on_detections(frame))


def test_frames_that_run_backwards_are_refused():
    with pytest.raises(MessageError, match="expected a frame after 4, got 4"):
        follow(seen(4), seen(4))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"iou_gate": 2.0}, "iou_gate: must be within 0..1, got 2.0"),
        ({"observed": 0}, "observed: expected 1 to 1000, got 0"),
        ({"horizon": 1001}, "horizon: expected 1 to 1000, got 1001"),
        ({"max_objects": 0}, "max_objects: must be at least 1, got 0"),
    ],
)
def test_a_setting_out_of_range_is_refused(given, said):
    with pytest.raises(SettingsError, match=re.escape(said)):
        AssociationSettings(**given)


object_ = st.tuples(
    st.floats(-100, 2100), st.floats(-100, 1200), st.floats(0, 200), st.integers(0, 1)
)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 20), st.lists(object_, max_size=8)), max_size=8))
def test_tracks_of_any_detections_are_finite_bounded_and_ordered(steps):
    seq, frames = -1, []
    for gap, objects in steps:
        seq += gap
        frames.append(seen(seq, *objects))

    for tracks in follow(*frames, max_objects=3, confirm=1):
        assert len(tracks.ids) <= 3
        assert (np.diff(tracks.ids) > 0).all()
        assert np.isfinite(tracks.predicted).all()
        assert np.isfinite(tracks.boxes).all()
        assert loads(Tracks, dumps(tracks)).ids.tolist() == tracks.ids.tolist()
