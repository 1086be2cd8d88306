"""Temporal ensembling: means of what chunks say of a step, older ones weighing more."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from operators.manipulation.ensemble import Ensemble


def chunk(value: float, length: int = 4) -> np.ndarray:
    return np.full((length, 2), value, np.float32)


def test_one_chunk_is_told_as_it_is() -> None:
    subject = Ensemble(0.01)
    subject.add(5, np.arange(8, dtype=np.float32).reshape(4, 2))

    assert subject.targets(6, 2).tolist() == [[2, 3], [4, 5]]


def test_older_chunks_weigh_more() -> None:
    subject = Ensemble(1.0)
    subject.add(0, chunk(0))
    subject.add(1, chunk(1))

    young = np.exp(-1) / (1 + np.exp(-1))
    np.testing.assert_allclose(subject.targets(1, 1)[0], young, rtol=1e-5)


def test_steps_that_no_chunk_reaches_are_not_told() -> None:
    subject = Ensemble(0.01)
    subject.add(0, chunk(1))

    assert len(subject.targets(2, 10)) == 2
    assert len(subject.targets(9, 10)) == 0


@given(st.lists(st.tuples(st.integers(1, 9), st.floats(-3, 3, width=32)), max_size=12))
def test_a_successor_tells_the_same(added: list[tuple[int, float]]) -> None:
    subject, successor, step = Ensemble(0.1), Ensemble(0.1), 0
    for gap, value in added:
        step += gap
        subject.add(step, chunk(value))

    successor.restore(subject.state())

    np.testing.assert_array_equal(successor.targets(step, 4), subject.targets(step, 4))
