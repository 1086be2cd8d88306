"""The table of sensors says what pytest says: nothing that was not run passes."""

import subprocess
import sys

from bench.sensors import KINDS, NAMES, counted, not_run
from tests.conftest import ROOT

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


def test_a_kind_without_tests_is_not_run() -> None:
    assert counted("a", REPORT.format(""), 1.0)["outcome"] == "not run"
    assert not_run("a", "needs a kernel")["outcome"] == "not run"


def test_every_kind_names_tests_that_there_are() -> None:
    files = [file for kind in KINDS for file in kind.tests]
    words = [sys.executable, "-m", "pytest", *files, "-k", NAMES, "-m", "not hardware",
             "--collect-only", "-p", "no:cacheprovider"]  # fmt: skip

    listed = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False).stdout

    assert [file for file in files if f"{file}::" not in listed] == []
