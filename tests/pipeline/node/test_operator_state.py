"""State of an operator that a swap would lose is named; state that `open` rebuilds is not."""

import array
import functools
import itertools
import logging
import queue
import random
import socket
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest

from pipeline import Operator, RunError
from pipeline.codec import dumps
from pipeline.node.operator_state import WITHOUT, UndeclaredState, restore
from pipeline.testing import drive, header
from tests.samples import WorkSettings
from tests.stateful_samples import (
    Counted,
    Counter,
    Forgetful,
    Loose,
    Mistaken,
    Recounted,
    Refusing,
    Unnamed,
    Unresolved,
    Unrestored,
)


@dataclass
class Table:
    """An object that an operator might keep its state in."""

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


class Slots:
    """An object without a dictionary."""

    __slots__ = ("gain", "rows")

    def __init__(self) -> None:
        self.gain, self.rows = 1.0, [1.0]


class Sharing(Forgetful):
    """An operator with state that all its instances share."""

    total = 0
    every_seen: ClassVar[list[int]] = []


def deep(value: int, levels: int) -> Any:
    return {"next": [deep(value, levels - 1)]} if levels else value


HIDDEN: dict[str, tuple[Callable[[], Any], Callable[[Any], object]]] = {
    "big array, one pixel": (
        lambda: np.zeros((1000, 700, 3), np.uint8),
        lambda v: v.__setitem__((901, 17, 1), 1),
    ),
    "big array, rolled": (
        lambda: np.arange(900_000.0),
        lambda v: v.__setitem__(slice(None), np.roll(v, 1)),
    ),
    "big array, strided": (
        lambda: np.zeros((2000, 2000), np.float32)[:, ::2],
        lambda v: v.__setitem__((slice(100, 200), slice(100, 200)), 1),
    ),
    "huge array, a region": (
        lambda: np.zeros((9000, 9000), np.uint8),
        lambda v: v.__setitem__((slice(700, 900), slice(700, 900)), 1),
    ),
    "bytearray": (lambda: bytearray(9), lambda v: v.__setitem__(3, 1)),
    "array of numbers": (lambda: array.array("d", [1, 2]), lambda v: v.__setitem__(0, 3)),
    "numpy generator": (lambda: np.random.default_rng(1), lambda v: v.random()),
    "numpy legacy generator": (lambda: np.random.RandomState(1), lambda v: v.rand()),
    "generator of random": (lambda: random.Random(1), lambda v: v.random()),
    "slots": (Slots, lambda v: setattr(v, "gain", 2.0)),
    "list in a slot": (Slots, lambda v: v.rows.append(2.0)),
    "count": (itertools.count, next),
    "iterator": (lambda: iter([1, 2, 3]), next),
    "generator": (lambda: (n for n in range(9)), next),
    "queue": (queue.Queue, lambda v: v.put(1)),
    "partial": (lambda: functools.partial(print, [1]), lambda v: v.args[0].append(2)),
    "namespace": (lambda: SimpleNamespace(a=1), lambda v: setattr(v, "a", 2)),
    "end of a long list": (lambda: [0.0] * 90_000, lambda v: v.__setitem__(89_999, 1.0)),
    "middle of a long list": (lambda: [0.0] * 90_000, lambda v: v.__setitem__(45_678, 1.0)),
    "end of a very long list": (lambda: [[0]] * 200_000, lambda v: v.__setitem__(-1, [1])),
    "middle of a very long list": (
        lambda: [0] * 300_000,
        lambda v: v.__setitem__(slice(140_000, 150_000), [1] * 10_000),
    ),
    "newest of a long dictionary": (
        lambda: {n: (n,) for n in range(20_000)},
        lambda v: v.__setitem__(19_999, (0,)),
    ),
    "depth": (lambda: deep(1, 5), lambda v: v.__setitem__("next", [deep(2, 4)])),
    "minus one": (lambda: [-1], lambda v: v.__setitem__(0, -2)),
    "objects in an array": (
        lambda: np.array([[1], None], dtype=object),
        lambda v: v[0].append(1),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", HIDDEN)
def test_a_change_in_place_is_found_wherever_it_is_kept(name: str) -> None:
    make, change = HIDDEN[name]
    operator: Any = kept()
    operator.hidden = make()
    before = UndeclaredState(operator)
    assert before.names() == []

    change(operator.hidden)

    assert before.names() == ["hidden"]


def test_what_a_class_keeps_for_its_instances_is_found() -> None:
    operator = Sharing(WorkSettings())
    operator.open()
    before = UndeclaredState(operator)
    assert before.names() == []

    Sharing.total += 1
    Sharing.every_seen.append(1)

    assert before.names() == ["every_seen", "total"]


def test_an_object_that_cannot_be_looked_into_is_named_as_such() -> None:
    operator: Any = kept()
    operator.kalman = cv2.KalmanFilter(4, 2)
    operator.inner.background = cv2.createBackgroundSubtractorMOG2()
    before = UndeclaredState(operator)

    operator.seen = 1

    assert before.names() == [
        "inner (cannot be looked into)", "kalman (cannot be looked into)", "seen"
    ]  # fmt: skip


class Changing(dict[int, int]):
    """As a dictionary that another thread fills while it is looked at."""

    def items(self) -> Any:
        raise RuntimeError("dictionary changed size during iteration")


class Unwritable(float):
    def __repr__(self) -> str:
        raise ValueError("no text")


@pytest.mark.parametrize(
    "value", [Changing({1: 2}), Unwritable(1), [Changing()]], ids=["changing", "unwritable", "list"]
)
def test_what_fails_while_it_is_looked_at_is_named_and_ends_nothing(value: Any) -> None:
    operator: Any = Forgetful(WorkSettings())
    operator.value = value

    assert UndeclaredState(operator).names() == ["value (cannot be looked into)"]


def test_what_belongs_to_the_process_is_no_state(tmp_path: Path) -> None:
    operator: Any = kept()
    ours, theirs = socket.socketpair()
    with (tmp_path / "file").open("wb") as file, ours, theirs:
        operator.file, operator.socket = file, ours
        operator.lock, operator.event = threading.Lock(), threading.Event()
        operator.thread = threading.Thread(target=print)
        operator.log, operator.call = logging.getLogger("x"), print
        before = UndeclaredState(operator)

        file.write(b"x")
        operator.event.set()

        assert before.names() == []


def test_an_attribute_that_equals_its_value_after_open_is_not_lost() -> None:
    operator: Any = kept()
    before = UndeclaredState(operator)

    operator.rate = 0.25 + 0.25
    operator.settings = WorkSettings(gain=2)  # the successor has these from the graph

    assert before.names() == []


def test_recursive_or_large_state_is_looked_at_within_bounds() -> None:
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
        (Forgetful, "it has no state()"),
        (Unnamed, "its state() names no dataclass as what it returns"),
        (Unresolved, "its state() names no dataclass as what it returns"),
        (Unrestored, "it declares state() and no restore()"),
        (Recounted, "Recount has other fields than before"),
    ],
)
def test_a_state_that_cannot_be_carried_over_is_an_error_only_within_one_class(
    cls: type[Operator[Any, Any]], said: str
) -> None:
    data = dumps(Counted(count=3))

    assert restore(cls(WorkSettings()), data) == f"begins anew: {said}"
    with pytest.raises(RunError) as caught:
        restore(cls(WorkSettings()), data, must=True)
    assert str(caught.value) == f"the state cannot be carried over: {said}{WITHOUT}"


@pytest.mark.parametrize(
    ("cls", "said"),
    [
        (Unnamed, "its state() names no dataclass as what it returns"),
        (Unrestored, "it declares state() and no restore()"),
        (Mistaken, "Counted.count: expected int"),
        (Loose, ""),
    ],
)
def test_a_state_that_no_swap_could_carry_over_fails_the_test_of_its_operator(
    cls: type[Operator[Any, Any]], said: str
) -> None:
    with pytest.raises(RunError) as caught:
        drive(cls, [])

    assert str(caught.value).startswith(f"{cls.__name__}: a swap cannot carry its state over: ")
    assert said in str(caught.value)


def test_a_state_that_a_swap_carries_over_passes() -> None:
    assert drive(Counter, []) == []


def test_a_restore_that_fails_is_an_error_whatever_it_raises() -> None:
    with pytest.raises(
        RunError, match=r"its restore\(\) failed: .+\.py:[0-9]+: ValueError: 3 is too many"
    ):
        restore(Refusing(WorkSettings()), dumps(Counted(count=3)))
