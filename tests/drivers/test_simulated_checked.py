"""A source of one's own that is wrong is named, with what was expected of it."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.simulated.checked import check_source, checked_picture, checked_truth
from drivers.source import Annotations
from pipeline.errors import DriverError

NAME = f"{__name__}:Own"


class Own:
    """A source of four small pictures, but for what a test changes about it."""

    def __init__(self, **changes: Any) -> None:
        self.size_px: Any = (32, 16)
        self.rate_hz: Any = 0.0
        self.length: Any = 4
        self.shown: Any = np.zeros((16, 32, 3), np.uint8)
        self.told: Any = None
        vars(self).update(changes)

    def picture(self, index: int) -> NDArray[np.uint8]:
        return self.shown  # type: ignore[no-any-return]

    def truth(self, index: int) -> Annotations | None:
        return self.told  # type: ignore[no-any-return]

    def close(self) -> None:
        """Nothing is open."""


def test_what_a_source_promises_is_taken() -> None:
    for right in (Own(), Own(length=None, rate_hz=30), Own(size_px=(np.int64(32), 16))):
        check_source(right)
        assert checked_picture(right, 0) is right.shown
        assert checked_truth(right, 0) is None


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"size_px": (32.0, 16)}, "size_px: expected two whole numbers of 1 to 65536, got (32.0"),
        ({"size_px": (32, 0)}, "size_px: expected two whole numbers of 1 to 65536, got (32, 0)"),
        ({"size_px": None}, "size_px: expected two whole numbers of 1 to 65536, got None"),
        ({"rate_hz": -3}, "rate_hz: expected a finite number from 0 on, got -3"),
        ({"rate_hz": float("nan")}, "rate_hz: expected a finite number from 0 on, got nan"),
        ({"length": 2.5}, "length: expected a whole number from 0 on, or None, got 2.5"),
    ],
)
def test_a_source_with_a_wrong_size_rate_or_length_is_refused(
    changes: dict[str, Any], said: str
) -> None:
    with pytest.raises(DriverError) as refused:
        check_source(Own(**changes))

    assert str(refused.value).startswith(f"{NAME}: {said}")


@pytest.mark.parametrize(
    ("shown", "got"),
    [
        (np.zeros((10, 32, 3), np.uint8), "uint8 (10, 32, 3)"),
        (np.zeros((16, 32), np.uint8), "uint8 (16, 32)"),
        (np.zeros((16, 32, 3)), "float64 (16, 32, 3)"),
        (None, "None"),
    ],
)
def test_a_picture_of_another_shape_or_type_is_refused(shown: Any, got: str) -> None:
    with pytest.raises(DriverError) as refused:
        checked_picture(Own(shown=shown), 2)

    assert str(refused.value) == f"{NAME}: picture 2: expected uint8 (16, 32, 3), got {got}"


def test_a_truth_of_another_kind_is_refused() -> None:
    with pytest.raises(DriverError, match="truth 2: expected Annotations or None, got dict"):
        checked_truth(Own(told={"boxes": []}), 2)
