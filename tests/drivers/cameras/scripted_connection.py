"""Connections to a camera that follow a script: the lowest seam of `NewestFrame`."""

import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.cameras.newest import Connection
from pipeline.errors import DriverError

Step = int | str | tuple[int, int] | threading.Event


class ScriptedConnection:
    """A connection that takes one step of a script for each frame that is asked for.

    A number is a frame that shows it, a size is a frame of that size, an event blocks until it is
    set. "damaged" is a frame that cannot be decoded, "quiet" a timeout, any other text the end.
    """

    def __init__(self, steps: Iterator[Step]) -> None:
        self._steps = steps
        self._step: Step = ""
        self.closed = False

    def wait(self, timeout_s: float) -> bool:
        self._step = next(self._steps, "the script ended")
        if isinstance(self._step, threading.Event):
            self._step.wait(30)
            return False
        if self._step == "quiet":
            threading.Event().wait(0.01)
            return False
        if isinstance(self._step, str) and self._step != "damaged":
            raise DriverError(f"camera: {self._step}")
        return True

    def decode(self, into: NDArray[Any] | None) -> NDArray[Any] | None:
        if isinstance(self._step, tuple):
            return np.zeros((*self._step[::-1], 3), np.uint8)
        if not isinstance(self._step, int):
            return None
        found = np.empty((4, 6, 3), np.uint8) if into is None else into
        found[:] = self._step
        return found

    def close(self) -> None:
        self.closed = True


def scripted(
    *scripts: Callable[[], Iterator[Step]] | str,
) -> tuple[Callable[[], Connection], list[ScriptedConnection]]:
    """A function that connects to the next script; a text is a connection that fails so."""
    left, made = iter(scripts), list[ScriptedConnection]()

    def connect() -> Connection:
        script = next(left, "it is gone")
        if isinstance(script, str):
            raise DriverError(f"camera: {script}")
        made.append(ScriptedConnection(script()))
        return made[-1]

    return connect, made
