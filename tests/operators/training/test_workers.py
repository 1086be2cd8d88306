"""Jobs beside a process end with it."""

import time

import pytest

from operators.training.workers import pool_of


def test_after_an_error_what_has_not_begun_never_does() -> None:
    with pytest.raises(KeyError), pool_of(1) as pool:  # noqa: PT012
        jobs = [pool.submit(time.sleep, 0.05) for _ in range(100)]
        jobs[0].result()
        raise KeyError

    assert all(job.done() for job in jobs)
    assert sum(job.cancelled() for job in jobs) > 80


def test_every_job_is_done_where_nothing_goes_wrong() -> None:
    with pool_of(2) as pool:
        jobs = [pool.submit(divmod, number, 3) for number in range(10)]

    assert [job.result() for job in jobs] == [divmod(number, 3) for number in range(10)]
