"""The executor provides the memory that an operator writes its outputs into."""

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from pipeline import Frame, Input, Operator
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
