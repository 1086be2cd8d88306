"""Errors of the processes that prepare a training's batches, as sentences."""

import signal
from collections.abc import Iterable, Iterator
from multiprocessing import resource_tracker
from typing import TypeVar

from pipeline.errors import FoveaError

T = TypeVar("T")


def _begun(batches: Iterable[T]) -> Iterator[T]:
    """Begin a loader whose processes never get a Ctrl-C: their end is the training's to tell."""
    resource_tracker.ensure_running()  # begun later, it would let the processes get it
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return iter(batches)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def in_sentences(batches: Iterable[T]) -> Iterator[T]:
    """The batches of a loader; what a process of it raises of fovea's errors has its sentence only.

    Torch raises the error again with the traceback of that process before the sentence.

    >>> def broken():
    ...     yield 1
    ...     raise FoveaError("Caught FoveaError in process 0.\\npipeline.errors.FoveaError: a: b")
    >>> list(in_sentences(broken()))
    Traceback (most recent call last):
    pipeline.errors.FoveaError: a: b
    """
    try:
        yield from _begun(batches)
    except FoveaError as error:
        name = f"{type(error).__module__}.{type(error).__qualname__}: "
        raise type(error)(str(error).rstrip().rpartition(name)[2]) from None
