"""Verifying: faint candidates are looked at one after another until one is verified."""

import numpy as np
import pytest

from operators.policy import VerifyingPolicy, VerifyingPolicySettings
from operators.policy.candidates import faint_odds
from operators.policy.verifying import SearchState
from pipeline import RoiFeatures, Scanpath, SettingsError, Tracks, codec
from pipeline.node.operator_state import restore
from pipeline.settings import build
from pipeline.testing import header
from tests.operators.policy.made_up import tracks

PLACES = {1: (300, 300), 2: (1500, 800), 3: (1500, 200)}


def world(seq: int, *ids: int) -> Tracks:
    """Return faint balls far apart, the first the faintest, and a crowd."""
    crowd = [(20 + k, 1, 900.0 + 50 * k, 500.0, 0.0) for k in range(3)]
    frame = tracks(seq, *[(k, 0, *PLACES[k], 0.0) for k in ids], *crowd)
    frame.scores[: len(ids)] = [0.1 + 0.1 * k for k in ids]
    return frame


class Run:
    """A policy in its loop: the ROI shows what the plan before looked at."""

    def __init__(self, genuine: dict[int, float], **values: object) -> None:
        given = {"target": "ball", "patience": 5} | values
        settings = build(VerifyingPolicySettings, given, "policy")
        self.policy = VerifyingPolicy(settings)
        self.policy.open()
        self.genuine = genuine
        self.seq = 0
        self.judges = True
        self.path: Scanpath | None = None

    def frame(self, *ids: int) -> Scanpath:
        frame = world(self.seq, *ids)
        shown = [k for k in ids if self.judges and self.path and self.looks_at(k)]
        self.policy.on_features(
            RoiFeatures(
                header=frame.header,
                ids=np.array(shown, np.int32),
                features=np.zeros((len(shown), 3), np.float32),
                genuine=np.array([self.genuine[k] for k in shown], np.float32),
            )
        )
        self.path = self.policy.on_tracks(frame)
        self.seq += 1
        return self.path

    def looks_at(self, object_id: int) -> bool:
        assert self.path is not None
        centre = (self.path.boxes[0, :2] + self.path.boxes[0, 2:]) / 2
        away = np.abs(centre - PLACES[object_id])
        return bool((away < (240, 135)).all())

    def looked_at(self, frames: int, *ids: int) -> list[int]:
        """Run; return the ball that is looked at in each frame, 0 for none."""
        seen = []
        for _ in range(frames):
            self.frame(*ids)
            seen.append(next((k for k in PLACES if self.looks_at(k)), 0))
        return seen


def test_candidates_are_looked_at_in_the_order_of_their_scores_until_one_is_verified() -> None:
    run = Run({1: 0.9, 2: 0.02, 3: 0.02})

    seen = run.looked_at(30, 1, 2, 3)

    assert list(dict.fromkeys(seen)) == [3, 2, 1]
    assert seen[-15:] == [1] * 15


def plain(run: Run, seq: int, genuine: float) -> int:
    """Return the choice where the context is sure of ball 1, and what the ROI shows of it."""
    frame = world(seq, 1, 2)
    frame.scores[0] = 0.9
    shown = {"ids": np.array([1], np.int32), "features": np.zeros((1, 3), np.float32)}
    verdict = np.array([genuine], np.float32)
    run.policy.on_features(RoiFeatures(header=frame.header, genuine=verdict, **shown))
    return int(run.policy.on_tracks(frame).choice[0])


def test_what_the_context_is_sure_of_is_followed_at_once() -> None:
    assert plain(Run({}), 0, 0.5) == 1


def test_what_the_context_is_sure_of_and_the_roi_refutes_is_let_go() -> None:
    run = Run({}, patience=24)

    choices = [plain(run, seq, 0.0001) for seq in range(50)]

    assert choices[0] == 1
    assert choices[-10:] == [-1] * 10
    assert run.policy.state().locked == -1


def test_the_consumer_is_told_of_a_verified_candidate_and_of_none_before() -> None:
    run = Run({1: 0.02, 2: 0.9})

    choices = [int(run.frame(1, 2).choice[0]) for _ in range(12)]

    assert choices[:2] == [-1] * 2
    assert choices[-1] == 2


def test_a_window_that_shows_several_candidates_is_looked_at_first() -> None:
    run = Run({1: 0.5, 2: 0.5, 3: 0.5})
    frame = tracks(0, (1, 0, 300, 300, 0), (2, 0, 1500, 800, 0), (3, 0, 1560, 820, 0))
    frame.scores[:] = (0.27, 0.25, 0.26)

    path = run.policy.on_tracks(frame)

    assert (path.boxes[0] > 790).sum() >= 2


def test_a_candidate_that_is_likelier_takes_over() -> None:
    run = Run({1: 0.98, 3: 0.5})
    run.looked_at(10, 3)

    assert run.looked_at(1, 1, 3) == [3]
    for k in range(6):  # the ROI happens to show the other one, too
        frame = world(run.seq + k, 1, 3)
        run.policy.on_features(
            RoiFeatures(
                header=frame.header, ids=np.array([1], np.int32),
                features=np.zeros((1, 3), np.float32), genuine=np.array([0.98], np.float32),
            )
        )  # fmt: skip
        path = run.policy.on_tracks(frame)

    assert path.choice[0] == 1


def test_a_sure_target_is_followed_without_looking_elsewhere() -> None:
    run = Run({1: 0.02, 3: 0.99}, patience=50)
    run.looked_at(20, 3)

    assert set(run.looked_at(30, 1, 3)) == {3}


def test_a_look_that_was_begun_ends_once_another_candidate_is_surely_the_target() -> None:
    run = Run({1: 0.5, 3: 0.99}, patience=50)
    beside = {1: PLACES[3], 3: (PLACES[3][0] - 60, PLACES[3][1])}

    def frame(seq: int) -> Tracks:
        both = tracks(seq, *[(k, 0, *beside[k], 0.0) for k in (1, 3)])
        both.scores[:] = (0.54, 0.5)
        return both

    choices = []
    for seq in range(12):  # only one of the two in the window can be judged
        seen = frame(seq)
        run.policy.on_features(
            RoiFeatures(
                header=seen.header, ids=np.array([3], np.int32),
                features=np.zeros((1, 3), np.float32), genuine=np.array([0.99], np.float32),
            )
        )  # fmt: skip
        choices.append(int(run.policy.on_tracks(seen).choice[0]))

    assert choices == [-1] + [3] * 11


@pytest.mark.parametrize("least", [0.0, 0.08])
def test_a_target_that_turns_out_to_be_of_another_class_is_let_go(least: float) -> None:
    run = Run({1: 0.9}, patience=50, least_probability=least)
    run.looked_at(20, 1)

    choices = set()
    for k in range(50 + 5):
        frame = tracks(run.seq + k, (1, 1, *PLACES[1], 0.0))
        choices.add(int(run.policy.on_tracks(frame).choice[0]))

    assert run.policy.state().locked == -1


def test_a_target_that_was_followed_is_kept_while_its_class_is_misread_for_a_moment() -> None:
    run = Run({1: 0.9}, patience=5)
    run.looked_at(20, 1)

    choices = []
    for k in range(4):
        frame = tracks(run.seq + k, (1, 1, *PLACES[1], 0.0))
        choices.append(int(run.policy.on_tracks(frame).choice[0]))
    choices.append(int(run.policy.on_tracks(world(run.seq + 4, 1)).choice[0]))

    assert choices == [1] * 5


def test_a_sure_target_is_not_left_for_one_that_the_context_takes_for_as_sure() -> None:
    run = Run({1: 0.999, 3: 0.5}, patience=50)

    def run_on(frames: int, *ids: int) -> set[int]:
        choices = set()
        for _ in range(frames):
            frame = world(run.seq, *ids)
            frame.scores[: len(ids)] = 0.9
            run.policy.on_features(
                RoiFeatures(
                    header=frame.header, ids=np.array([1], np.int32),
                    features=np.zeros((1, 3), np.float32), genuine=np.array([0.999], np.float32),
                )
            )  # fmt: skip
            choices.add(int(run.policy.on_tracks(frame).choice[0]))
            run.seq += 1
        return choices

    run_on(12, 1)

    assert run_on(20, 1, 3) == {1}


def test_odds_are_the_contexts_until_the_roi_showed_a_candidate() -> None:
    scores, shown = np.array([0.5, 0.5, 0.5], np.float32), np.array([0.5, 0.9, 0.1], np.float32)

    unseen = faint_odds(scores, shown, np.zeros(3, np.bool_))
    seen = faint_odds(scores, shown, np.ones(3, np.bool_))

    assert unseen == pytest.approx([0.66] * 3)
    assert seen == pytest.approx([0.02, 2.217, -2.177], abs=1e-3)


def test_where_nothing_is_verified_people_are_looked_at_in_the_end() -> None:
    run = Run({3: 0.02})
    run.looked_at(12, 3)

    run.frame(3)

    assert run.path is not None
    assert 800 < run.path.boxes[0, 0] < 1100


def test_a_target_that_was_followed_is_waited_for_where_it_was_lost() -> None:
    run = Run({1: 0.9, 2: 0.9}, patience=10)
    assert run.looked_at(25, 1)[-1] == 1

    assert run.looked_at(4, 2) == [1] * 4


def test_what_was_locked_for_a_moment_is_forgotten() -> None:
    run = Run({1: 0.9, 2: 0.3}, patience=20)
    while run.frame(1).choice[0] != 1:
        assert run.seq < 20

    assert run.looked_at(3, 2)[-1] == 2


def test_its_state_crosses_a_swap() -> None:
    run = Run({1: 0.9})
    run.looked_at(12, 1)
    other = VerifyingPolicy(run.policy.settings)
    other.open()

    answer = restore(other, codec.dumps(run.policy.state()))

    assert answer == "carried over"
    assert other.state().search == run.policy.state().search
    assert other.on_tracks(world(run.seq, 1)).choice[0] == 1


def test_a_setting_that_is_gone_is_told_in_a_sentence() -> None:
    with pytest.raises(SettingsError, match="looks: removed; a verdict takes two looks"):
        build(VerifyingPolicySettings, {"looks": 7}, "policy")


def test_a_target_that_the_roi_refutes_for_long_is_let_go() -> None:
    run = Run({1: 0.9, 2: 0.02}, patience=50)
    assert run.looked_at(20, 1)[-1] == 1
    run.genuine[1] = 0.005

    choices = [int(run.frame(1).choice[0]) for _ in range(50 + 5)]

    assert choices[40] == 1
    assert set(choices[-3:]) == {-1}


def test_candidates_that_are_never_judged_are_passed_over() -> None:
    run = Run({1: 0.5, 2: 0.5, 3: 0.5})
    run.judges = False

    seen = run.looked_at(60, 1, 2, 3)

    assert list(dict.fromkeys(seen))[:3] == [3, 2, 1]
    assert seen[-1] == 0


def test_another_target_is_looked_for_from_the_beginning() -> None:
    run = Run({1: 0.9})
    run.looked_at(20, 1)

    run.policy.on_settings(build(VerifyingPolicySettings, {"target": "player"}, "policy"))

    assert run.policy.state().search == SearchState()


def test_another_stream_is_looked_through_from_the_beginning() -> None:
    run = Run({1: 0.9})
    run.looked_at(20, 1)

    run.policy.on_stream(header(0, stream="another"))

    assert run.policy.state().search == SearchState()
    assert run.policy.state().locked == -1


def test_frames_without_objects_are_searched() -> None:
    run = Run({})

    assert (run.policy.on_tracks(tracks(0)).boxes[:, 2] > 0).all()


def test_a_ball_lost_beside_a_person_is_not_looked_for_at_that_person() -> None:
    policy = Run({}, patience=4).policy
    x, y = PLACES[1]
    for seq in range(15):
        ball = [(1, 0, x, y, 0.0)] if seq < 12 else []
        person_x = x + 15.0 if seq < 12 else x + 900.0
        frame = tracks(seq, *ball, (30, 1, person_x, y - 15.0, 0.0))
        policy.on_features(
            RoiFeatures(
                header=frame.header, ids=np.array([1], np.int32),
                features=np.zeros((1, 3), np.float32), genuine=np.array([0.99], np.float32),
            )
        )  # fmt: skip
        path = policy.on_tracks(frame)
        assert seq != 11 or path.choice[0] == 1

    assert abs((path.boxes[0, 0] + path.boxes[0, 2]) / 2 - x) < 100
