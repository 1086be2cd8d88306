"""Decode ahead: source frame numbers in, pictures out, one picture ahead of its reader.

One thread asks the source for the next picture while the reader waits for that picture's time.
A source may reuse its buffer, so the reader asks for the next one only when it has done with the
last: no picture is ever copied. Decoders release the interpreter lock.
"""

import os
import queue
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.simulated.checked import checked_picture, checked_truth
from drivers.simulated.windows import Picture, picture_of
from drivers.source import Annotations, FrameSource

WORLD_NICENESS = 5


@dataclass(frozen=True, kw_only=True, eq=False)
class Ready:
    """A picture of the source. Several frames asked for together come as their mean."""

    seq: int  # the exposure it was asked for
    pixels: Picture  # (h, w, 3) RGB, valid until the next `ask`; made later where read by windows
    truth: Annotations | None  # of the last frame
    ready_ns: int
    cost_ns: int  # time the source took


class Prefetch:
    """`ask`, then `take`, in turns, by one thread; the source is only touched by the worker."""

    def __init__(self, source: FrameSource) -> None:
        self._source = source
        self._asked: queue.SimpleQueue[tuple[int, Sequence[int]] | None] = queue.SimpleQueue()
        self._done: queue.SimpleQueue[Ready | Exception] = queue.SimpleQueue()
        self._mean = _Mean()
        self._thread = threading.Thread(target=self._work, name="prefetch", daemon=True)
        self._thread.start()

    def ask(self, seq: int, indices: Sequence[int]) -> None:
        """Begin to make the picture of exposure `seq` from these source frames."""
        self._asked.put((seq, indices))

    def take(self) -> Ready:
        """Wait for the picture asked for; raises what the source raised."""
        found = self._done.get()
        if isinstance(found, Exception):
            raise found
        return found

    def close(self) -> None:
        """End the thread; a picture in the making is finished first."""
        self._asked.put(None)
        self._thread.join()

    def _work(self) -> None:
        _yield_to_the_graph()
        while (task := self._asked.get()) is not None:
            try:
                self._done.put(self._make(*task))
            except Exception as error:  # raised again where it can be handled, in `take`
                self._done.put(error)

    def _make(self, seq: int, indices: Sequence[int]) -> Ready:
        began_ns = time.monotonic_ns()
        pixels: Picture
        if len(indices) == 1:
            pixels = picture_of(self._source, indices[0])
        else:
            pixels = self._mean.of(self._source, indices)
        truth = checked_truth(self._source, indices[-1])
        now_ns = time.monotonic_ns()
        return Ready(
            seq=seq, pixels=pixels, truth=truth, ready_ns=now_ns, cost_ns=now_ns - began_ns
        )


def _yield_to_the_graph() -> None:
    """Give the graph priority where cores are scarce: a real sensor needs no CPU.

    A niceness that is greater already stays: a user may not lower it.
    """
    me = threading.get_native_id()
    with suppress(OSError):  # the pictures come without it, too
        own = os.getpriority(os.PRIO_PROCESS, me)
        os.setpriority(os.PRIO_PROCESS, me, max(WORLD_NICENESS, own))


class _Mean:
    """The average of several pictures, in memory of its own."""

    def __init__(self) -> None:
        self._sum = np.empty((0, 0, 3), np.float32)
        self._pixels = np.empty((0, 0, 3), np.uint8)

    def of(self, source: FrameSource, indices: Sequence[int]) -> NDArray[np.uint8]:
        for number, index in enumerate(indices):
            picture = checked_picture(source, index)
            if number == 0:
                if self._sum.shape != picture.shape:
                    self._sum = np.empty(picture.shape, np.float32)
                    self._pixels = np.empty(picture.shape, np.uint8)
                np.copyto(self._sum, picture)
            else:
                cv2.accumulate(picture, self._sum)
        cv2.convertScaleAbs(self._sum, self._pixels, 1 / len(indices))
        return self._pixels
