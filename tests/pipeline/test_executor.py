"""The executor provides the memory that an operator writes its outputs into."""

import functools
from typing import Any

import numpy as np
import pytest
from numpy.typing import DTypeLike, NDArray

from pipeline import Frame, Input, Operator, SettingsError
from pipeline.contract import fresh_memory
from pipeline.executor import Executor
from pipeline.testing import header, picture


class Writer(Operator[None, Frame]):
    """Writes into memory of its output."""

    frame = Input(Frame, keep="every")

    def on_frame(self, frame: Frame) -> Frame:
        pixels = self.loan(frame.pixels.shape, np.uint8)
        pixels[:] = frame.pixels
        return Frame(header=frame.header, pixels=pixels)


class Late(Operator[None, Frame]):
    """Gets its handler, of another argument, when it is made."""

    frame = Input(Frame)

    def __init__(self, settings: None) -> None:
        super().__init__(settings)
        self.on_frame = self._take

    def _take(self, picture: Frame) -> Frame:
        return picture


def repeated(method: Any) -> Any:
    """Pass a handler one more argument than it is called with."""

    @functools.wraps(method)
    def call(self: Any, frame: Frame) -> Any:
        return method(self, frame, 2)

    return call


class Wrapped(Operator[None, Frame]):
    """Has a handler in a decorator."""

    frame = Input(Frame)

    @repeated
    def on_frame(self, frame: Frame, _times: int) -> Frame:
        return frame


def test_a_handler_that_an_instance_has_is_checked_when_it_is_called() -> None:
    frame = Frame(header=header(), pixels=picture(4, 4, seed=1))

    with pytest.raises(SettingsError, match="expected the arguments frame, got missing a required"):
        Executor("late", Late(None)).call({"frame": frame})


def test_a_handler_in_a_decorator_takes_what_the_decorator_takes() -> None:
    frame = Frame(header=header(), pixels=picture(4, 4, seed=1))

    assert Executor("wrapped", Wrapped(None)).call({"frame": frame})["out"] is frame


def written(executor: Executor) -> Any:
    frame = Frame(header=header(), pixels=picture(4, 4, seed=1))
    answer = executor.call({"frame": frame})["out"]
    assert isinstance(answer, Frame)
    return answer.pixels


def test_an_operator_writes_into_the_memory_that_its_executor_was_given() -> None:
    own = np.zeros((4, 4, 3), np.uint8)

    def memory(
        output: str, shape: tuple[int, ...], dtype: DTypeLike, /, *, ahead: bool = False
    ) -> NDArray[Any]:
        assert (output, shape, dtype) == ("out", own.shape, np.uint8)
        return own

    executor = Executor("writer", Writer(None), memory=memory)

    assert written(executor) is own
    assert executor.allocate_from(fresh_memory) is memory
    assert written(executor) is not own
    assert executor.allocate_from(memory) is fresh_memory
