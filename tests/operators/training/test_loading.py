"""The processes that prepare batches leave the end of a training to it."""

import signal
from collections.abc import Iterator

from operators.training.loading import in_sentences


class Loader:
    """Begins its processes when it is asked for its first batch, as torch's does."""

    blocked: "set[signal.Signals | int]"

    def __iter__(self) -> Iterator[int]:
        self.blocked = signal.pthread_sigmask(signal.SIG_BLOCK, ())  # what they inherit
        return iter((1, 2))


def test_processes_that_load_get_no_interruption_and_the_training_does() -> None:
    loader = Loader()
    batches = in_sentences(loader)

    assert next(batches) == 1

    assert signal.SIGINT in loader.blocked
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    assert list(batches) == [2]
