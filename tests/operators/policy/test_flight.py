"""A target that was followed and is lost is followed on its way, where the context shows it."""

import pytest

from operators.policy.verifying import ESCAPED_SCORE
from pipeline import Tracks
from tests.operators.policy.made_up import tracks
from tests.operators.policy.test_verifying import PLACES, Run

X, Y = PLACES[2]
FRAMES = 4  # that tracks show


def flying(seq: int, kicked_seq: int, step_px: float, score: float, shown: bool = True) -> Tracks:
    """Return a crowd, and a ball that left the place of ball 2 and flies to the left."""
    x = X - step_px * (seq - kicked_seq)
    frame = tracks(
        seq, (9, 0, x, float(Y), 0.0), *[(20 + k, 1, 900.0 + 50 * k, 500.0, 0) for k in range(3)]
    )
    frame.scores[0] = score
    frame.visible[0] = shown
    return frame


def followed() -> Run:
    """A policy whose target, ball 2, was followed and is gone from now on."""
    run = Run({2: 0.98}, patience=12)
    assert run.looked_at(40, 2)[-1] == 2
    return run


def gaze(run: Run, frames: int, **ball: float) -> list[bool]:
    """Return in which frames the window shows the ball that flies."""
    kicked, found = run.seq, []
    for _ in range(frames):
        frame = flying(run.seq, kicked, **ball)  # type: ignore[arg-type]
        box = run.policy.on_tracks(frame).boxes[0]
        centre = (frame.boxes[0, -1, :2] + frame.boxes[0, -1, 2:]) / 2
        found.append(bool((box[:2] < centre).all() and (centre < box[2:]).all()))
        run.seq += 1
    return found


def test_a_ball_that_flies_from_where_the_target_was_is_followed() -> None:
    shown = gaze(followed(), 12, step_px=25.0, score=ESCAPED_SCORE + 0.1)

    assert all(shown)


@pytest.mark.parametrize(
    "ball",
    [
        {"step_px": 25.0, "score": ESCAPED_SCORE - 0.05},
        {"step_px": 90.0, "score": ESCAPED_SCORE + 0.1},
        {"step_px": 25.0, "score": ESCAPED_SCORE + 0.1, "shown": False},
    ],
    ids=["faint", "faster than a ball", "hidden"],
)
def test_what_may_be_something_else_is_not(ball: dict[str, float]) -> None:
    shown = gaze(followed(), 12, **ball)

    assert not any(shown[-3:])


def test_it_is_followed_for_as_long_as_a_lost_target_is_waited_for() -> None:
    shown = gaze(followed(), 40, step_px=25.0, score=ESCAPED_SCORE + 0.1)

    assert all(shown[:12])
    assert not any(shown[-10:])


def test_the_consumer_is_bound_to_it_at_once() -> None:
    run = followed()
    kicked = run.seq

    paths = [run.policy.on_tracks(flying(kicked + k, kicked, 25.0, 0.4)) for k in range(4)]

    assert [int(path.choice[0]) for path in paths] == [9] * 4


def test_where_no_target_was_followed_nothing_escaped() -> None:
    run = Run({}, patience=12)

    frames = [tracks(seq, (9, 0, 50.0, 50.0, 0.0)) for seq in range(8)]
    for frame in frames:
        frame.scores[0] = ESCAPED_SCORE + 0.1
    choices = [int(run.policy.on_tracks(frame).choice[0]) for frame in frames]

    assert choices == [-1] * 8
