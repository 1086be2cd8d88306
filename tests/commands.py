"""Run commands in the process of the tests, because starting a process takes half a second.

This is for commands that query or control a running graph, and for input that is refused before
anything runs. Tests of signals, of imports and of running a graph need a process of their own.
"""

import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from typing import IO

import pytest

from pipeline import cli
from pipeline.bus.session import silence

# Before any session of this process, as `fovea` does: the first call decides what Zenoh prints, and
# it prints on the standard output, which holds a command's result.
silence()


def command(*words: str) -> "subprocess.CompletedProcess[str]":
    """Run `fovea WORDS`; return its exit status and output."""
    status: object = 0
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        with pytest.MonkeyPatch.context() as patch, leading_to(1, out), leading_to(2, err):
            patch.setattr(sys, "argv", ["fovea", *words])
            try:
                cli._carry_out()
            except SystemExit as left:
                status = left.code or 0
        assert isinstance(status, int)
        said = [os.pread(file.fileno(), 1 << 24, 0).decode() for file in (out, err)]
    return subprocess.CompletedProcess(words, status, *said)


@contextlib.contextmanager
def leading_to(handle: int, file: IO[bytes]) -> Iterator[None]:
    """Redirect standard output or standard error, stream and descriptor, to a file."""
    before = os.dup(handle)
    os.dup2(file.fileno(), handle)
    redirect = contextlib.redirect_stdout if handle == 1 else contextlib.redirect_stderr
    try:
        with open(handle, "w", encoding="utf-8", closefd=False) as stream, redirect(stream):
            try:
                yield
            finally:
                (sys.stdout if handle == 1 else sys.stderr).flush()  # perhaps replaced
    finally:
        os.dup2(before, handle)
        os.close(before)
