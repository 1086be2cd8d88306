"""Errors are printed in one sentence, and a signal ends a command and its jobs at once."""

import argparse
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path

import pytest

from operators.training.command_line import GOES_ON, count, in_a_sentence
from pipeline import SettingsError
from tests.operators.training.test_workers import ended, wait_for

BUSY = """
import os, signal, time
from pathlib import Path
from operators.training.command_line import GOES_ON, in_a_sentence
from operators.training.workers import pool_of

def job():
    Path({told!r}).write_text(str(os.getpid()))
    time.sleep(1000)

if __name__ == "__main__":
    # as at a terminal; a process that is started in the background ignores it
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with in_a_sentence(GOES_ON), pool_of(1) as pool:
        pool.submit(job).result()
"""


ALLOCATOR = "DefaultCPUAllocator: can't allocate memory: 9 bytes"
CUDA = "CUDA out of memory. Tried to allocate 20.00 MiB."


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (SettingsError("seed: must be at least 0, got -1"), "seed: must be at least 0, got -1"),
        (NotADirectoryError(20, "Not a directory", "a/b"), "a/b: expected a folder, got a file"),
        (PermissionError(13, "Permission denied", "a/b"), "a/b: Permission denied"),
        (OSError(28, "No space left on device"), "[Errno 28] No space left on device"),
        (RuntimeError(f"{ALLOCATOR}\nat 0x7"), f"not enough memory: {ALLOCATOR}"),
        (RuntimeError(CUDA), f"not enough memory: {CUDA}"),
        (MemoryError(), "not enough memory"),
    ],
)
def test_expected_errors_are_printed_in_a_sentence(
    error: Exception, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as refused, in_a_sentence():
        raise error

    assert refused.value.code == 2
    assert capsys.readouterr().err == f"fovea: {said}\n"


def test_a_training_without_enough_memory_says_what_needs_less(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit), in_a_sentence(GOES_ON):
        raise RuntimeError(CUDA)

    said = f"fovea: not enough memory; a smaller --batch needs less: {CUDA}\n"
    assert capsys.readouterr().err == said


@pytest.mark.parametrize("error", [ZeroDivisionError(), RuntimeError("shapes do not fit")])
def test_unexpected_errors_keep_their_traceback(error: Exception) -> None:
    with pytest.raises(type(error)), in_a_sentence():
        raise error


def test_signal_handlers_are_restored_afterwards() -> None:
    before = signal.getsignal(signal.SIGTERM)

    with in_a_sentence():
        assert signal.getsignal(signal.SIGTERM) != before

    assert signal.getsignal(signal.SIGTERM) == before


@pytest.mark.parametrize(
    ("sent", "status", "said"),
    [
        (signal.SIGTERM, 143, ""),
        (signal.SIGINT, 130, "fovea: interrupted; repeat the command to resume\n"),
    ],
)
def test_a_signal_ends_a_command_and_its_jobs_at_once(
    tmp_path: Path, sent: signal.Signals, status: int, said: str
) -> None:
    told, script = tmp_path / "pid", tmp_path / "busy.py"
    script.write_text(BUSY.format(told=str(told)))
    busy = subprocess.Popen(
        [sys.executable, str(script)], stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    wait_for(lambda: told.exists() and told.read_text())

    os.killpg(busy.pid, sent)  # as a terminal does
    _, errors = busy.communicate(timeout=120)

    assert (busy.returncode, errors) == (status, said)
    assert ended(int(told.read_text()))


ENDING = """
import atexit, os, signal, time
from pathlib import Path
from operators.training.command_line import GOES_ON, in_a_sentence

def end_slowly():
    Path({told!r}).write_text("ending")
    time.sleep(1000)

atexit.register(end_slowly)
signal.signal(signal.SIGINT, signal.default_int_handler)
with in_a_sentence(GOES_ON):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(1000)
"""


def test_a_second_interruption_ends_a_command_that_ends_slowly(tmp_path: Path) -> None:
    told = tmp_path / "told"
    ending = subprocess.Popen(
        [sys.executable, "-c", ENDING.format(told=str(told))], stderr=subprocess.PIPE, text=True
    )
    wait_for(lambda: told.exists() and told.read_text())

    ending.send_signal(signal.SIGINT)
    _, errors = ending.communicate(timeout=120)

    said = "fovea: interrupted; repeat the command to resume\n"
    assert (ending.returncode, errors) == (130, said)


def test_a_count_begins_at_one() -> None:
    assert count("3") == 3
    with pytest.raises(argparse.ArgumentTypeError, match="must be at least 1, got 0"):
        count("0")


def main_of(module: str) -> Callable[[list[str]], None]:
    """Return the command line of a module; skip the test if its packages are missing."""
    for needed in ("torch", "onnx"):
        pytest.importorskip(needed, reason="needs the train extra")
    main: Callable[[list[str]], None] = import_module(module).main
    return main


def refused(
    main: Callable[[list[str]], None], words: Sequence[object], capsys: pytest.CaptureFixture[str]
) -> str:
    """Run a command line that must end with 2; return the last line of its errors."""
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    assert ended.value.code == 2
    return capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize("room", ["saliency", "roi_features"])
def test_wrong_options_of_a_training_are_refused(
    room: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main = main_of(f"operators.{room}.train")
    data, out, file = tmp_path / "data", tmp_path / "out", tmp_path / "file"
    file.write_text("")

    def said(*words: object) -> str:
        return refused(main, [*words, "--threads", 1, "--device", "cpu"], capsys)

    few = ("--scenes", 8, "--moments", 2)
    assert "must be at least 1, got 0" in said("--data", data, "--out", out, "--steps", 0)
    if room == "saliency":
        assert "raw_share: must be within" in said("--data", data, "--out", out, "--raw-share", 2)
    assert "rate: must be above 0, got nan" in said("--data", data, "--out", out, "--rate", "nan")
    no_folder = f"fovea: {file}: expected a folder, got a file"
    assert said("--data", data, "--out", file, *few) == no_folder
    assert said("--data", file, "--out", out, *few) == no_folder
    (out / "checkpoint.pt").write_bytes(b"PK")
    assert "checkpoint.pt: expected a state dict" in said("--data", data, "--out", out, *few)
    assert not data.exists()


@pytest.mark.parametrize("room", ["saliency", "roi_features"])
def test_wrong_options_of_an_evaluation_are_refused(
    room: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main = main_of(f"operators.{room}.evaluate")
    gone, file = tmp_path / "gone.onnx", tmp_path / "file"
    file.write_text("")

    assert f"{gone}: no such weights" in refused(main, ["--weights", gone], capsys)
    said = refused(main, ["--data", file], capsys)
    what = "expected the folder of a sequence (seqinfo.ini, img1/), got a file"
    assert said == f"fovea: {file}: {what}"
    assert "must be at least 1, got 0" in refused(main, ["--moments", 0], capsys)
