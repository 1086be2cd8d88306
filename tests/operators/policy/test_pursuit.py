"""Pursuit: gaining, keeping, losing and searching for one object."""

from dataclasses import replace

import numpy as np
import pytest

from operators.policy import PursuitPolicy, PursuitPolicySettings
from pipeline import RoiFeatures, Scanpath, SettingsError, Tracks
from pipeline.testing import drive
from tests.operators.policy.made_up import tracks

BALL = {"target": "ball"}


def first_choices(paths: list[Scanpath]) -> list[int]:
    return [int(path.choice[0]) for path in paths]


def pursue(*frames: Tracks, **values: object) -> list[Scanpath]:
    return drive(PursuitPolicy, frames, values)


def test_a_candidate_is_followed_once_it_was_seen_in_three_frames():
    unseen_at_first = [tracks(k, (4, 0, 300 + 5 * k, 300, 5)) for k in range(3)]
    for frame in unseen_at_first:
        frame.visible[:, :-1] = False

    paths = pursue(*unseen_at_first, **BALL)

    assert first_choices(paths) == [-1, -1, 4]
    np.testing.assert_allclose(paths[2].boxes[4], [327, 292, 343, 308])


def test_the_object_is_kept_when_another_is_only_a_little_better():
    frames = [tracks(k, (1, 0, 300, 300, 0), (2, 0, 900, 300, 0)) for k in range(8)]
    for frame in frames[1:]:
        frame.scores[1] = 0.6

    assert first_choices(pursue(*frames, **BALL)) == [1] * 8


def test_a_clearly_better_rival_takes_over_after_three_frames():
    frames = [tracks(k, (1, 0, 300, 300, 0), (2, 0, 900 + 9 * k, 300, 9)) for k in range(6)]
    for k, frame in enumerate(frames):
        frame.scores[:] = (0.5, 0.9 if k > 1 else 0.1)

    assert first_choices(pursue(*frames, **BALL)) == [1, 1, 1, 1, 2, 2]


def test_a_target_whose_class_is_misread_is_kept_until_one_of_its_class_is_seen():
    sure = [tracks(k, (1, 0, 300, 300, 0)) for k in range(3)]
    misread = [tracks(k, (1, 1, 300, 300, 0)) for k in range(3, 6)]
    beside_a_faint_one = [tracks(k, (1, 1, 300, 300, 0), (2, 0, 900, 300, 0)) for k in range(6, 10)]
    for frame in beside_a_faint_one:
        frame.scores[:] = (0.9, 0.2)

    paths = pursue(*sure, *misread, *beside_a_faint_one, **BALL)

    assert first_choices(paths) == [1] * 6 + [1, 1, 2, 2]


def test_after_a_misread_target_no_other_class_is_followed():
    sure = [tracks(k, (1, 0, 300, 300, 0), (2, 1, 900, 300, 0)) for k in range(3)]
    misread = [tracks(k, (1, 1, 300, 300, 0), (2, 1, 900, 300, 0)) for k in range(3, 6)]
    gone = [tracks(k, (2, 1, 900, 300, 0)) for k in range(6, 9)]

    assert first_choices(pursue(*sure, *misread, *gone, **BALL)) == [1] * 6 + [-1] * 3


def test_without_a_prompt_a_change_of_class_does_not_move_the_gaze():
    frames = [tracks(k, (1, int(k > 2), 300, 300, 0), (2, 1, 900, 300, 0)) for k in range(6)]
    for frame in frames:
        frame.scores[:] = (0.9, 0.2)

    assert first_choices(pursue(*frames, confirm=1)) == [1] * 6


def test_a_ball_lost_while_it_is_misread_is_looked_for_where_most_people_are():
    crowd = [(10 + k, 1, 1540.0 + 20 * k, 800.0, 0.0) for k in range(4)]
    seen = [tracks(k, (1, 0, 300, 300, 0), *crowd) for k in range(3)]
    misread = [tracks(k, (1, 1, 300, 300, 0), *crowd) for k in range(3, 5)]

    path = pursue(*seen, *misread, tracks(5, *crowd), patience=0, **BALL)[-1]

    assert path.choice[0] == -1
    np.testing.assert_allclose(path.boxes[0], [1520, 780, 1560, 820])


def test_a_ball_lost_while_it_is_misread_beside_a_person_is_looked_for_at_that_person():
    seen = [tracks(k, (1, 0, 300, 300, 0), (2, 1, 320, 300, 0)) for k in range(3)]
    misread = [tracks(k, (1, 1, 300, 300, 0), (2, 1, 320, 300, 0)) for k in range(3, 5)]

    path = pursue(*seen, *misread, tracks(5, (2, 1, 340, 310, 2)), **BALL)[-1]

    assert path.choice[0] == -1
    np.testing.assert_allclose(path.boxes[0], [322, 290, 362, 330])


def test_a_referee_lost_while_misread_as_a_ball_is_waited_for_and_not_carried_by_a_player():
    names = ("ball", "player", "referee")
    player = (2, 1, 320, 300, 0)
    seen = [tracks(k, (1, 2, 300, 300, 0), player) for k in range(3)]
    misread = [tracks(k, (1, 0, 300, 300, 0), player) for k in range(3, 5)]
    gone = tracks(5, (2, 1, 900, 300, 0))
    frames = [replace(frame, names=names) for frame in (*seen, *misread, gone)]

    path = pursue(*frames, target="referee")[-1]

    assert path.choice[0] == -1
    np.testing.assert_allclose(path.boxes[0], [292, 292, 308, 308])  # as it was last seen


def test_one_object_is_found_again_by_its_own_class_whatever_class_is_set():
    start = [tracks(k, (1, 1, 300, 300, 0)) for k in range(3)]
    back = [tracks(k, (7, 1, 330, 300, 0)) for k in range(4, 7)]

    paths = pursue(*start, tracks(3), *back, target_id=1, **BALL)

    assert first_choices(paths) == [1, 1, 1, -1, 7, 7, 7]


def test_a_target_asked_for_by_box_is_the_track_that_overlaps_it_best():
    world = [tracks(k, (1, 1, 300, 300, 0), (2, 1, 330, 300, 0)) for k in range(2)]

    paths = pursue(*world, prompt_box=(312.0, 282.0, 352.0, 318.0))

    assert first_choices(paths) == [2, 2]


def test_the_prompt_box_is_shown_until_a_track_is_in_it():
    (path,) = pursue(tracks(0, (1, 1, 900, 900, 0)), prompt_box=(10.0, 20.0, 50.0, 60.0))

    assert path.choice[0] == -1
    assert path.boxes[0].tolist() == [10, 20, 50, 60]


def test_a_person_lost_is_found_again_near_by_not_far_away():
    start = [tracks(k, (1, 1, 300, 300, 0), (2, 1, 1200, 300, 0)) for k in range(3)]
    gone = [tracks(3, (2, 1, 1200, 300, 0))]
    back = [tracks(k, (2, 1, 1200, 300, 0), (7, 1, 330, 300, 0)) for k in range(4, 7)]

    paths = pursue(*start, *gone, *back, target_id=1)

    assert first_choices(paths) == [1, 1, 1, -1, 7, 7, 7]


def test_a_ball_lost_beside_a_person_is_searched_for_at_that_person():
    seen = [tracks(k, (1, 0, 300, 300, 0), (2, 1, 320, 300, 0)) for k in range(3)]
    lost = tracks(3, (2, 1, 340, 310, 2))

    path = pursue(*seen, lost, **BALL)[-1]

    assert path.choice[0] == -1
    np.testing.assert_allclose(path.boxes[0], lost.predicted[0, 0])


def test_a_ball_unseen_for_a_few_frames_is_believed_to_be_carried():
    frames = [tracks(k, (1, 0, 300, 300, 9), (2, 1, 320, 300, 0)) for k in range(3)]
    frames += [
        tracks(k, (1, 0, 300 + 9 * k, 300, 9), (2, 1, 320, 300, 0), unseen=(1,))
        for k in range(3, 7)
    ]

    assert first_choices(pursue(*frames, **BALL)) == [1, 1, 1, 1, 1, 1, -1]


def test_a_ball_lost_in_the_open_is_expected_where_it_was_and_then_searched_for():
    seen = [tracks(k, (1, 0, 300, 300, 0)) for k in range(3)]
    lost = [tracks(k) for k in range(3, 40)]

    paths = pursue(*seen, *lost, patience=10, **BALL)

    waiting, searching = paths[4].boxes, paths[-1].boxes
    assert ((waiting[:8, :2] + waiting[:8, 2:]) / 2 == 300).all()
    assert (searching[:, 2] - searching[:, 0] == 480).all()


def test_one_object_that_is_lost_is_waited_for_where_it_was():
    seen = [tracks(k, (1, 1, 300, 300, 0)) for k in range(3)]

    paths = pursue(*seen, *[tracks(k) for k in range(3, 80)], patience=10, target_id=1)

    assert ((paths[-1].boxes[:, :2] + paths[-1].boxes[:, 2:]) / 2 == 300).all()


def test_the_search_visits_the_whole_field_beginning_near_the_loss():
    seen = [tracks(k, (1, 0, 300, 300, 0)) for k in range(3)]

    paths = pursue(*seen, *[tracks(k) for k in range(3, 40)], patience=0, **BALL)

    boxes = np.array([path.boxes[0] for path in paths[3:]])
    assert len(np.unique(boxes, axis=0)) == 16  # 1920x1080 in windows of 480x270
    assert boxes[0].tolist() == [0, 270, 480, 540]


def test_a_ball_that_nobody_has_seen_is_looked_for_where_most_people_are():
    people = [(k, 1, 1500.0 + 20 * k, 800.0, 0.0) for k in range(2, 6)]
    alone = (7, 1, 200.0, 200.0, 0.0)

    path = pursue(*[tracks(k, *people, alone) for k in range(4)], **BALL)[-1]

    left, top, right, bottom = path.boxes[0]
    assert path.choice[0] == -1
    assert all(
        left - 240 < x < right + 240 and top - 135 < y < bottom + 135 for _, _, x, y, _ in people
    )


def test_a_person_who_is_asked_for_by_class_is_not_looked_for_among_people():
    crowd = [(k, 1, 1500.0 + 20 * k, 800.0, 0.0) for k in range(2, 6)]
    unseen = [tracks(k, *crowd, unseen=(2, 3, 4, 5)) for k in range(4)]

    path = pursue(*unseen, target="player")[-1]

    assert (path.boxes[0, 2] - path.boxes[0, 0]) == 480  # a window of the field


def test_a_class_that_no_track_can_have_is_warned_of_once(caplog: pytest.LogCaptureFixture):
    frames = [tracks(k, (1, 0, 300, 300, 0)) for k in range(3)]

    pursue(*frames, target="dog")

    assert caplog.messages == ["policy.target: expected one of ball, player, got dog"]


def looked(*frames: Tracks, genuine: dict[int, float], **values: object) -> list[Scanpath]:
    """Return the plans of a policy to which the ROI shows these objects in every frame."""
    subject = PursuitPolicy(PursuitPolicySettings(**BALL | {"least_probability": 0.05} | values))
    subject.open()
    paths = []
    for frame in frames:
        paths.append(subject.on_tracks(frame))
        subject.on_features(
            RoiFeatures(
                header=frame.header,
                ids=np.array(list(genuine), np.int32),
                features=np.zeros((len(genuine), 3), np.float32),
                genuine=np.array(list(genuine.values()), np.float32),
            )
        )
    return paths


def weak(seq: int) -> Tracks:
    """Return two faint balls far apart."""
    frame = tracks(seq, (1, 0, 300, 300, 0), (2, 0, 1500, 800, 0))
    frame.scores[:] = 0.3
    return frame


def shown(path: Scanpath, x: float, y: float) -> bool:
    """Whether a plan looks at a ball there in the next frame."""
    centre = (path.boxes[0, :2] + path.boxes[0, 2:]) / 2
    return bool(np.abs(centre - (x, y)).max() < 10 and np.ptp(path.boxes[0, ::2]) < 20)


def test_a_faint_candidate_is_followed_only_once_the_roi_verified_it():
    frames = [weak(k) for k in range(12)]

    assert not any(shown(path, 1500, 800) for path in looked(*frames, genuine={2: 0.3})[9:])
    assert all(shown(path, 1500, 800) for path in looked(*frames, genuine={2: 0.9})[3:])


def test_a_consumer_is_told_of_a_candidate_only_when_it_is_surely_the_target():
    frames = [tracks(k, (1, 0, 300, 300, 0)) for k in range(8)]

    faint = looked(*frames, genuine={1: 0.6})[-1]
    for frame in frames:
        frame.scores[:] = 0.7
    sure = looked(*frames, genuine={1: 0.9})[-1]

    assert shown(faint, 300, 300)
    assert shown(sure, 300, 300)
    assert (faint.choice[0], sure.choice[0]) == (-1, 1)


def test_a_target_that_the_roi_refutes_is_given_up():
    frames = [tracks(k, (1, 0, 300, 300, 0)) for k in range(40)]

    kept, refuted = (looked(*frames, genuine={1: p}, patience=5)[-1] for p in (0.6, 0.02))

    assert shown(kept, 300, 300)
    assert not shown(refuted, 300, 300)


def test_a_prompted_target_is_kept_whatever_the_roi_shows():
    frames = [tracks(k, (1, 0, 300, 300, 0)) for k in range(8)]

    paths = looked(*frames, genuine={1: 0.0}, target_id=1)

    assert all(shown(path, 300, 300) for path in paths)


def test_a_probability_out_of_range_is_refused():
    with pytest.raises(SettingsError, match="least_probability: must be at least 0"):
        PursuitPolicySettings(least_probability=1.0)
