"""Memory: the latest looks through the ROI by frame."""

import numpy as np
import pytest

from operators.policy.memory import Memory, blank, fault, recall, remember
from pipeline import MessageError, RoiFeatures
from pipeline.testing import header


def look(seq: int, genuine: float = 1.0, **features: float) -> RoiFeatures:
    return RoiFeatures(
        header=header(seq),
        ids=np.array([int(name[1:]) for name in features], np.int32),
        features=np.array([[value] * 3 for value in features.values()], np.float32).reshape(-1, 3),
        genuine=np.full(len(features), genuine, np.float32),
    )


def after(*looks: RoiFeatures) -> Memory:
    memory = blank()
    for seen in looks:
        memory = remember(memory, seen, observed=4)
    return memory


def test_a_look_is_in_the_column_of_its_frame() -> None:
    memory = after(look(5, t1=1, t9=9), look(6), look(7, t9=2))

    found = recall(memory, np.array([1, 4, 9], np.int32), seq=8, observed=4, channels=3)

    assert found[:, :, 0].tolist() == [[1, 0, 0, 0], [0, 0, 0, 0], [9, 0, 2, 0]]


def test_looks_older_than_the_history_are_gone() -> None:
    memory = after(look(5, t1=1), look(9, t2=1))

    assert memory.ids.tolist() == [2]
    assert not recall(memory, np.array([1], np.int32), seq=9, observed=4, channels=3).any()


def test_looks_are_recalled_by_id_in_any_order() -> None:
    found = recall(
        after(look(5, t1=1, t9=9)), np.array([9, 1], np.int32), seq=5, observed=4, channels=3
    )

    assert found[:, -1, 0].tolist() == [9, 1]


@pytest.mark.parametrize("wrong", [float("nan"), float("inf")])
def test_a_look_that_is_not_finite_is_a_fault(wrong: float) -> None:
    said = "policy.features: expected finite numbers in frame 3, got others"

    assert fault(look(3, t1=wrong)) == fault(look(3, genuine=wrong, t1=1)) == said
    assert not fault(look(3, t1=1))


def test_features_of_another_width_are_refused() -> None:
    with pytest.raises(MessageError, match="expected 5 channels, got 3"):
        recall(after(look(1, t1=1)), np.array([1], np.int32), seq=1, observed=4, channels=5)
