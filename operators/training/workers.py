"""Worker processes that end with this process."""

import ctypes
import os
import signal
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context

PR_SET_PDEATHSIG = 1  # of prctl(2): the signal that this process gets when its parent ends


@contextmanager
def pool_of(count: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of `count` processes; after an error, or a signal to stop, they end at once.

    A job must leave its file whole or not at all. Where this process is killed its jobs end too, on
    Linux; elsewhere each ends with what it does.
    """
    spawn = get_context("spawn")
    with ProcessPoolExecutor(
        count, mp_context=spawn, initializer=_end_with, initargs=(os.getpid(),)
    ) as pool:
        try:
            yield pool
        except BaseException:
            # a job may take minutes; `kill_workers` does the same from Python 3.14 on
            for process in list((pool._processes or {}).values()):
                process.kill()
            pool.shutdown(cancel_futures=True)
            raise


def _end_with(parent: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to all; the parent answers
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it ended before it could be told to the kernel
        os._exit(1)
