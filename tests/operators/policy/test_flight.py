"""Flight: a target that was followed and is lost is followed on its way, while it moves."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from operators.policy.flight import LONGEST, Flight, next_flight
from operators.policy.target import TargetSpec
from pipeline import Tracks
from tests.operators.policy.made_up import tracks
from tests.operators.policy.test_verifying import PLACES, Run

X, Y = PLACES[2]
LEFT = np.array([X - 8, Y - 8, X + 8, Y + 8], np.float32)  # where the target was last seen
FAINT, PATIENCE = 0.12, 12
BALL = TargetSpec(label="ball")


def flying(
    seq: int, away_px: float, step_px: float = -25.0, *, shown: bool = True, turns_px: float = 0.0,
    person_at: float = 900.0, person_shown: bool = True,
) -> Tracks:  # fmt: skip
    """Return a crowd that a turning camera moves, and a faint ball beside the place of ball 2."""
    ball = (9, 0, X + away_px, float(Y), step_px + turns_px)
    crowd = [(20 + k, 1, person_at + 50 * k, float(Y) - 15, turns_px) for k in range(4)]
    frame = tracks(seq, ball, *crowd)
    frame.scores[0] = FAINT
    frame.visible[0] = shown
    frame.visible[1:] = person_shown
    return frame


def begun(lost: int = 4, spec: TargetSpec = BALL, **ball: Any) -> Flight:
    return next_flight(flying(100, **ball), Flight(), spec, LEFT, lost)


def test_what_flies_straight_away_from_where_the_target_was_is_followed() -> None:
    assert begun(away_px=-100.0) == Flight(track_id=9, since_seq=100)


@pytest.mark.parametrize(
    "ball",
    [
        {"away_px": -100.0, "step_px": 25.0},
        {"away_px": -100.0, "step_px": -2.0},
        {"away_px": -10.0},
        {"away_px": -300.0},
        {"away_px": -100.0, "shown": False},
        {"away_px": -100.0, "person_at": X - 110.0},
        {"away_px": -100.0, "step_px": 0.0, "turns_px": -25.0},
    ],
    ids=[
        "flies towards it", "slow", "still there", "farther than a ball flies", "hidden",
        "at somebody's feet", "moved by the camera",
    ],
)  # fmt: skip
def test_what_may_be_something_else_is_not(ball: Mapping[str, Any]) -> None:
    assert begun(**ball) == Flight()


def test_of_a_camera_that_turns_along_no_motion_is_left() -> None:
    assert begun(away_px=-100.0, turns_px=25.0).track_id == 9


def test_a_person_whom_nobody_sees_hides_no_flight() -> None:
    assert begun(away_px=-100.0, person_at=X - 110.0, person_shown=False).track_id == 9


def test_a_ball_without_others_flies_as_well() -> None:
    alone = tracks(100, (9, 0, X - 100.0, float(Y), -25.0))

    assert next_flight(alone, Flight(), BALL, LEFT, 4).track_id == 9


def test_a_box_that_is_no_number_spoils_no_flight() -> None:
    frame = flying(100, -100.0)
    frame.boxes[2] = np.nan

    assert next_flight(frame, Flight(), BALL, LEFT, 4).track_id == 9


def test_who_carries_balls_does_not_fly() -> None:
    runner = tracks(100, (9, 1, X - 100.0, float(Y), -25.0))

    assert next_flight(runner, Flight(), TargetSpec(label="player"), LEFT, 4) == Flight()


def test_who_may_not_carry_it_hides_no_flight() -> None:
    asked = TargetSpec(label="ball", carriers=())

    assert begun(away_px=-100.0, person_at=X - 110.0, spec=asked).track_id == 9


def test_a_flight_goes_on_wherever_it_leads_until_it_has_come_down() -> None:
    flight = begun(away_px=-100.0)

    assert next_flight(flying(101, -600.0, 25.0), flight, BALL, LEFT, 5) == flight
    assert next_flight(flying(102, -600.0, 1.0), flight, BALL, LEFT, 6) == Flight(over=True)


def relabelled() -> Tracks:
    frame = flying(101, -125.0)
    frame.labels[0] = 1
    return frame


@pytest.mark.parametrize(
    "frame",
    [tracks(101), flying(101, -125.0, shown=False), flying(100 + LONGEST, -600.0), relabelled()],
    ids=["gone", "hidden", "too long", "no ball any more"],
)
def test_a_flight_ends_when_nothing_shows_it_or_it_takes_too_long(frame: Tracks) -> None:
    assert next_flight(frame, begun(away_px=-100.0), BALL, LEFT, 5) == Flight(over=True)


def test_after_a_flight_no_other_is_followed() -> None:
    over = Flight(over=True)

    assert next_flight(flying(110, -100.0), over, BALL, LEFT, 4) == over


def test_without_tracks_nothing_flies() -> None:
    assert next_flight(tracks(100), Flight(), BALL, LEFT, 4) == Flight()


def followed() -> Run:
    """A policy whose target, ball 2, was followed and is gone from now on."""
    run = Run({2: 0.98}, patience=PATIENCE)
    assert run.looked_at(40, 2)[-1] == 2
    return run


def kicked(run: Run, frames: int, step_px: float = -25.0) -> tuple[list[bool], list[int]]:
    """Return in which frames the gaze goes along with a ball that flies left, and the choices."""
    shown, choices = [], []
    for k in range(frames):
        frame = flying(run.seq, step_px * (k + 1), step_px)
        path = run.policy.on_tracks(frame)
        shown.append(bool(np.allclose(path.boxes[0], frame.predicted[0, 0])))
        choices.append(int(path.choice[0]))
        run.seq += 1
    return shown, choices


def down(run: Run, away_px: float, frames: int) -> list[Any]:
    """Return the boxes that are looked at while the ball lies there."""
    boxes = []
    for _ in range(frames):
        boxes.append(run.policy.on_tracks(flying(run.seq, away_px, 0.0)).boxes[0])
        run.seq += 1
    return boxes


def test_the_gaze_goes_along_for_longer_than_a_lost_target_is_waited_for() -> None:
    shown, choices = kicked(followed(), 3 * PATIENCE)

    assert all(shown)
    assert set(choices) == {9}  # the consumer is bound to it at once


def test_where_it_came_down_it_is_waited_for() -> None:
    run = followed()
    kicked(run, 10)

    boxes = down(run, -250.0, 6)

    middles = [((box[:2] + box[2:]) / 2).tolist() for box in boxes]
    assert middles == [[X - 250.0, Y]] * 6


def test_where_no_target_was_followed_nothing_flies() -> None:
    run = Run({}, patience=PATIENCE)
    frames = [tracks(seq, (9, 0, 40.0 + 25 * seq, 40.0, 25.0)) for seq in range(8)]
    for frame in frames:
        frame.scores[:] = FAINT

    choices = [int(run.policy.on_tracks(frame).choice[0]) for frame in frames]

    assert choices == [-1] * 8


def test_a_target_that_is_found_again_may_be_kicked_again() -> None:
    run = followed()
    kicked(run, 10)
    down(run, -250.0, 4)
    assert run.policy.state().flight.over

    run.looked_at(60, 2)
    assert run.policy.state().locked == 2
    _, choices = kicked(run, 5)

    assert choices[1:] == [9] * 4


def test_a_successor_follows_the_same_flight() -> None:
    run = followed()
    kicked(run, 5)
    other = Run({2: 0.98}, patience=PATIENCE)
    other.policy.restore(run.policy.state())

    path = other.policy.on_tracks(flying(run.seq, -150.0))

    assert int(path.choice[0]) == 9
