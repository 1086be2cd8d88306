"""What the consumer sees corrects where an undetected target is believed to be."""

import numpy as np
import pytest
from numpy.typing import NDArray

from operators.policy.consumer import Consumer, consumer_of, corrected
from operators.policy.target import TargetState
from pipeline import Percept
from pipeline.testing import header
from tests.operators.policy.made_up import tracks

STILL = [(k, 1, 300.0 + 100 * k, 500.0, 0.0) for k in (12, 13, 14, 15)]
HERE = np.array([110, 100, 126, 116], np.float32)


def target(**changed: object) -> TargetState:
    known = {"bound_id": 1, "box": np.array([100, 100, 116, 116], np.float32), "seen_seq": 5}
    return TargetState(**(known | changed))  # type: ignore[arg-type]


def consumer(seq: int = 7, box: NDArray[np.float32] = HERE, **changed: object) -> Consumer:
    known = {"seq": seq, "box": box, "object_id": 1, "score": 0.8}
    return Consumer(**(known | changed))  # type: ignore[arg-type]


def test_an_undetected_target_is_where_the_consumer_sees_it() -> None:
    found = corrected(target(), consumer(), tracks(8, *STILL), 0.5)

    np.testing.assert_allclose(found.box, HERE)
    assert found.seen_seq == 5


def test_it_moves_with_the_camera_since_the_consumers_frame() -> None:
    panned = [(k, 1, x, y, 4.0) for k, _, x, y, _ in STILL]

    found = corrected(target(), consumer(seq=6), tracks(8, *panned), 0.5)

    np.testing.assert_allclose(found.box - HERE, [8, 0, 8, 0], atol=0.01)


def test_a_target_without_a_track_is_not_that_of_a_tracker_without_one() -> None:
    before = target(bound_id=-1)

    assert corrected(before, consumer(object_id=-1), tracks(8, *STILL), 0.5) is before


def test_a_detection_is_believed_more_than_the_consumer() -> None:
    before = target()

    assert corrected(before, consumer(), tracks(8, (1, 0, 108, 108, 0), *STILL), 0.5) is before


@pytest.mark.parametrize(
    "told",
    [
        Consumer(),
        consumer(score=0.4),
        consumer(score=float("nan")),
        consumer(object_id=2),
        consumer(seq=3),
        consumer(seq=9),
        consumer(box=np.array([110, 100, 190, 180], np.float32)),
        consumer(box=HERE + 900),
    ],
    ids=[
        "none",
        "unsure",
        "not a number",
        "another object",
        "too old",
        "of the future",
        "another size",
        "far",
    ],
)
def test_a_consumer_that_cannot_know_changes_nothing(told: Consumer) -> None:
    before = target()

    assert corrected(before, told, tracks(8, *STILL), 0.5) is before


@pytest.mark.parametrize("box", [[[np.nan, 0, 1, 1]], [[0, 0, np.inf, 1]], []])
def test_an_answer_without_a_finite_box_is_that_of_a_lost_object(box: list[list[float]]) -> None:
    boxes = np.array(box, np.float32).reshape(-1, 4)
    percept = Percept(
        header=header(4), boxes=boxes, ids=np.zeros(len(boxes), np.int32),
        scores=np.ones(len(boxes), np.float32),
    )  # fmt: skip

    found = consumer_of(percept)

    assert (found.seq, found.score) == (4, 0.0)
