"""The table of sensors says what pytest says: nothing that was not run passes."""

import subprocess
import sys
from pathlib import Path

import pytest

from bench.sensors import KINDS, NAMES, counted, not_run, run
from pipeline.errors import RunError
from tests.conftest import ROOT
from tests.sample_graphs import until

REPORT = "<testsuites><testsuite>{}</testsuite></testsuites>"


def test_a_kind_whose_tests_were_all_skipped_is_not_run_and_says_why() -> None:
    case = '<testcase><skipped message="no GStreamer here"/></testcase>'

    found = counted("a", REPORT.format(2 * case), 1.0)

    assert (found["outcome"], found["skipped"], found["note"]) == (
        "not run",
        2,
        "no GStreamer here",
    )


def test_one_failure_fails_the_kind() -> None:
    cases = '<testcase/><testcase><failure message="x"/></testcase><testcase><error/></testcase>'

    found = counted("a", REPORT.format(cases), 1.0)

    assert (found["outcome"], found["passed"], found["failed"]) == ("fails", 1, 2)


def test_a_program_that_does_not_end_is_killed_with_what_it_started(tmp_path: Path) -> None:
    left = tmp_path / "process"
    words = ["sh", "-c", f"sleep 3600 & echo $! > {left}; wait"]

    with pytest.raises(RunError, match=r"sh -c .*expected its end within 0.5 s, got none"):
        run(words, 0.5)

    number = left.read_text().strip()
    until(lambda: not Path(f"/proc/{number}").exists() or ") Z " in stat(number))


def stat(number: str) -> str:
    try:
        return Path(f"/proc/{number}/stat").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return ") Z "


def test_a_kind_without_tests_is_not_run() -> None:
    assert counted("a", REPORT.format(""), 1.0)["outcome"] == "not run"
    assert not_run("a", "needs a kernel")["outcome"] == "not run"


def test_every_kind_names_tests_that_there_are() -> None:
    files = [file for kind in KINDS for file in kind.tests]
    words = [sys.executable, "-m", "pytest", *files, "-k", NAMES, "-m", "not hardware",
             "--collect-only", "-p", "no:cacheprovider"]  # fmt: skip

    listed = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False).stdout

    assert [file for file in files if f"{file}::" not in listed] == []
