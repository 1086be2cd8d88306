"""The ruler of the bus benchmarks detects torn messages and reports clocks and rates."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.peers.ruler import (
    COLUMNS,
    HEAD_BYTES,
    ROOT,
    WARM_UP,
    Bytes,
    Meter,
    Task,
    Writer,
    collect,
    fill,
    is_whole,
)

NBYTES = 5000


def task_in(folder: Path, count: int = 3) -> Task:
    (folder / "ready").touch()
    return Task(nbytes=NBYTES, count=count, rate_hz=1e4, folder=folder)


def written(writer: Writer, number: int) -> Bytes:
    view = np.zeros(NBYTES, np.uint8)
    writer.begin(number)
    writer.write(view, number)
    return view


@given(number=st.integers(0, 10**6), place=st.integers(HEAD_BYTES, NBYTES - 1))
def test_a_message_with_one_wrong_byte_is_torn(number: int, place: int) -> None:
    view = np.zeros(NBYTES, np.uint8)
    fill(view, number)
    assert is_whole(view, number)

    view[place] ^= 1

    assert not is_whole(view, number)


def test_a_message_is_not_taken_for_the_one_before_or_after_it(tmp_path: Path) -> None:
    view = written(Writer(task_in(tmp_path)), 7)

    assert not is_whole(view, 6)
    assert not is_whole(view, 8)


def test_warm_up_is_not_counted_and_clocks_only_rise(tmp_path: Path) -> None:
    task = task_in(tmp_path)
    writer, meter = Writer(task), Meter(task)

    for number in range(task.total):
        meter.take(written(writer, number))
    writer.save()
    meter.save()
    result = collect(task, "none", "numpy")

    samples = np.array(result["samples"])
    assert samples[:, 0].tolist() == [WARM_UP, WARM_UP + 1, WARM_UP + 2]
    assert samples.shape == (3, len(COLUMNS))
    assert (np.diff(samples[:, 1:], axis=1) >= 0).all()
    assert result["torn"] == 0
    assert meter.finished


def test_torn_messages_are_reported(tmp_path: Path) -> None:
    task = task_in(tmp_path)
    writer, meter = Writer(task), Meter(task)
    view = written(writer, WARM_UP)
    view[1000] ^= 1

    meter.take(view)
    writer.save()
    meter.save()

    assert collect(task, "none", "numpy")["torn"] == 1


def test_a_meter_is_not_finished_while_the_sender_runs(tmp_path: Path) -> None:
    task = task_in(tmp_path)
    writer, meter = Writer(task), Meter(task)

    meter.take(written(writer, 0))

    assert not meter.finished


def test_the_rate_is_kept_from_the_first_message_on(tmp_path: Path) -> None:
    writer = Writer(Task(nbytes=NBYTES, count=1, rate_hz=0.01, folder=task_in(tmp_path).folder))

    assert writer.due_in_s(0) == 0.0
    assert writer.due_in_s(1) == pytest.approx(100.0, abs=1.0)


@pytest.mark.parametrize("module", ["bare", "zenoh_bytes", "fovea_bus"])
def test_a_contestant_delivers_every_message_whole(module: str) -> None:
    words = [sys.executable, "-m", f"bench.peers.{module}"]

    done = subprocess.run(
        [*words, "--nbytes=300000", "--count=4", "--rate-hz=20"],
        cwd=ROOT, capture_output=True, text=True, timeout=180, check=True,
    )  # fmt: skip
    result = json.loads(done.stdout)

    assert result["sent"] == 4
    assert [row[0] for row in result["samples"]] == list(range(WARM_UP, WARM_UP + 4))
    assert result["torn"] == 0
