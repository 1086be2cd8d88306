"""Jobs of a pool end with the process that started it."""

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from operators.training.workers import pool_of

PARENT = """
import os, time
from pathlib import Path
from operators.training.workers import pool_of

def job():
    Path({told!r}).write_text(str(os.getpid()))
    time.sleep(1000)

if __name__ == "__main__":
    with pool_of(1) as pool:
        pool.submit(job).result()
"""


def ended(pid: int) -> bool:
    try:
        return bool(psutil.Process(pid).status() == psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return True


def wait_for(seen: Callable[[], object], timeout_s: float = 60.0) -> None:
    end = time.monotonic() + timeout_s
    while not seen():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_after_an_error_no_further_job_begins() -> None:
    with pytest.raises(KeyError), pool_of(1) as pool:  # noqa: PT012
        jobs = [pool.submit(time.sleep, 0.05) for _ in range(100)]
        jobs[0].result()
        raise KeyError

    assert all(job.done() for job in jobs)
    assert sum(job.cancelled() or job.exception() is not None for job in jobs) > 80


def test_after_an_error_running_jobs_are_not_awaited() -> None:
    with pytest.raises(TypeError), pool_of(2) as pool:  # noqa: PT012
        pool.submit(time.sleep, 1000)
        failing = pool.submit(time.sleep, "soon")
        began = time.monotonic()
        failing.result()

    assert time.monotonic() - began < 500


def test_without_an_error_every_job_is_done() -> None:
    with pool_of(2) as pool:
        jobs = [pool.submit(divmod, number, 3) for number in range(10)]

    assert [job.result() for job in jobs] == [divmod(number, 3) for number in range(10)]


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux sends a signal at a parent's end")
def test_jobs_of_a_killed_process_end_with_it(tmp_path: Path) -> None:
    told = tmp_path / "pid"
    script = tmp_path / "parent.py"
    script.write_text(PARENT.format(told=str(told)))
    parent = subprocess.Popen([sys.executable, str(script)])
    try:
        wait_for(lambda: told.exists() and told.read_text())
        worker = int(told.read_text())

        parent.kill()
        parent.wait()

        wait_for(lambda: ended(worker))
    finally:
        parent.kill()
