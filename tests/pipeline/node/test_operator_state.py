"""What a swap would lose of an operator is known, and what `open` rebuilds is not called lost."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from pipeline import Operator, RunError
from pipeline.codec import dumps
from pipeline.node.operator_state import UndeclaredState, restore
from pipeline.testing import header
from tests.samples import WorkSettings
from tests.stateful_samples import (
    Counted,
    Counter,
    Forgetful,
    Refusing,
    Unnamed,
    Unresolved,
    Unrestored,
)


@dataclass
class Table:
    """Something that an operator might keep its state in."""

    rows: list[float] = field(default_factory=list)


def kept() -> Operator[Any, Any]:
    operator = Forgetful(WorkSettings())
    operator.open()
    every: Any = operator
    every.array = np.zeros((3, 3), np.float32)
    every.big = np.zeros(2_000_000, np.uint8)
    every.ring, every.ids, every.inner = deque([1, 2]), {1, 2}, Table([1.0])
    every.model, every.rate = object(), 0.5
    return operator


CHANGES: dict[str, Callable[[Any], object]] = {
    "seen": lambda o: setattr(o, "seen", 1),
    "recent": lambda o: o.recent.append(1),
    "table": lambda o: o.table["gain"].append(4),
    "array": lambda o: o.array.fill(1),
    "big": lambda o: setattr(o, "big", np.ones(2_000_000, np.uint8)),
    "ring": lambda o: o.ring.append(3),
    "ids": lambda o: o.ids.add(3),
    "inner": lambda o: o.inner.rows.append(2.0),
    "model": lambda o: setattr(o, "model", [o.model]),
    "new": lambda o: setattr(o, "new", header()),
}


@pytest.mark.parametrize("name", CHANGES)
def test_an_attribute_that_changed_since_it_was_opened_is_named_and_no_other(name: str) -> None:
    operator = kept()
    before = UndeclaredState(operator)

    CHANGES[name](operator)

    assert before.names() == [name]


def test_what_is_as_open_left_it_is_not_lost() -> None:
    operator: Any = kept()
    before = UndeclaredState(operator)

    operator.rate = 0.25 + 0.25
    operator.settings = WorkSettings(gain=2)  # the successor has these from the graph

    assert before.names() == []


def test_what_refers_to_itself_or_is_endless_is_looked_at_within_bounds() -> None:
    operator: Any = kept()
    operator.recent.append(operator.recent)
    operator.table["all"] = [list(range(100)) for _ in range(1000)]
    before = UndeclaredState(operator)

    operator.seen += 1

    assert before.names() == ["seen"]


def test_an_operator_that_declares_its_state_has_nothing_undeclared() -> None:
    operator = Counter(WorkSettings())
    operator.open()
    before = UndeclaredState(operator)

    operator.seen += 1

    assert before.names() == []


@pytest.mark.parametrize(
    ("cls", "said"),
    [
        (Unnamed, "its state() names no dataclass as what it returns"),
        (Unresolved, "its state() names no dataclass as what it returns"),
        (Unrestored, "it declares state() and no restore()"),
    ],
)
def test_a_state_that_cannot_be_carried_over_is_an_error_between_equals_only(
    cls: type[Operator[Any, Any]], said: str
) -> None:
    data = dumps(Counted(count=3))

    assert restore(cls(WorkSettings()), data) == f"begins anew: {said}"
    with pytest.raises(RunError) as caught:
        restore(cls(WorkSettings()), data, must=True)
    assert str(caught.value) == f"the state cannot be carried over: {said}"


def test_a_restore_that_fails_is_an_error_whatever_it_raises() -> None:
    with pytest.raises(RunError, match=r"its restore\(\) failed: ValueError: 3 is too many"):
        restore(Refusing(WorkSettings()), dumps(Counted(count=3)))
