"""The processes that prepare batches leave the end of a training to it."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

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


SPAWNING = """
import multiprocessing, signal
from operators.training.loading import in_sentences

def tell(queue):
    queue.put(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ()))

class Loader:
    def __iter__(self):
        spawn = multiprocessing.get_context("spawn")
        queue = spawn.SimpleQueue()  # the first semaphore begins what lets signals through again
        process = spawn.Process(target=tell, args=(queue,))
        process.start()
        blocked = queue.get()
        process.join()
        return iter([blocked])

if __name__ == "__main__":
    print(*in_sentences(Loader()))
"""


def test_a_spawned_process_gets_no_interruption(tmp_path: Path) -> None:
    script = tmp_path / "spawning.py"
    script.write_text(SPAWNING)
    paths = os.pathsep.join(filter(None, [os.getcwd(), *sys.path]))

    told = subprocess.run(
        [sys.executable, str(script)], env={**os.environ, "PYTHONPATH": paths},
        capture_output=True, text=True, check=True,
    )  # fmt: skip

    assert told.stdout == "True\n"
